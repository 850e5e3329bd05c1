"""What logs, inversions and errors hold at their edges: time limits, bounds of the box, rows kept back, lost states."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mpge_jax
from mpge_jax.grounding import inversion, transform_error, transformer
from mpge_jax.grounding.early_stop import EarlyStop
from mpge_jax.grounding.inversion import InversionConfig
from mpge_jax.rollouts import target_log
from tests import points, probes, small


def test_a_time_limit_ends_a_logged_episode_and_is_no_termination():
    log = points.log(steps=90)
    # 30 rows of each policy, in episodes of 20 steps; the point never terminates.
    assert np.asarray(log.count).tolist() == [30, 30, 30]
    np.testing.assert_array_equal(log.episode, np.tile(np.arange(30) // 20, (3, 1)))
    np.testing.assert_array_equal(log.terminated, np.zeros((3, 30)))


def test_an_action_at_the_edge_of_the_box_is_inverted_too():
    """Differences are taken inwards there. Asked for 5, clipped to 1, the target moves as the source under 0.5."""
    pushing = points.policies().replace(params=jnp.array([[0.0, 5.0], [0.0, -5.0]]))
    shifts = (-0.5, 0.5)
    logs = small.stacked(
        *(target_log.collect(jax.random.key(0), probes.point(shift=shift), pushing, 20) for shift in shifts)
    )
    found = jax.jit(jax.vmap(lambda log: inversion.invert(points.SOURCE, log, InversionConfig())))(logs)
    wanted = [np.clip(np.repeat([1.0, -1.0], 10) + shift, -1.0, 1.0) for shift in shifts]
    np.testing.assert_allclose(found.explained[..., 0], wanted, atol=1e-3)


def test_the_error_along_rollouts_is_of_the_states_that_the_transformer_leads_to():
    """A residual of 0.25 x drives the point away from 0, to where it is about 1; the bare point stays within it."""
    made = transformer.init(jax.random.key(0), 1, 1, transformer.TransformerConfig(hidden=()))
    layer = {"kernel": jnp.array([[0.25], [0.0]]), "bias": jnp.zeros(1)}
    away = made.replace(params={**made.params, "mean": {"params": {"Dense_0": layer}}})
    env = probes.point(max_steps=1000)
    error = jax.jit(lambda key: transform_error.in_rollouts(key, away, env, lambda action: action))
    # At x of 0.96 on average, the bare point's, it would be below 0.24.
    assert 0.5 < float(error(jax.random.key(0))) < 1.0


def test_grounding_learns_nothing_from_the_rows_that_judge_it():
    log = points.log()
    # The last 5 of 20 rows are kept back; what they hold changes the verdict and nothing else.
    other = log.replace(next_observation=log.next_observation.at[:, 15:].add(0.3))
    stopping = EarlyStop(share=0.25, rows=15, patience=10)
    # Every row of the log is drawn by D.
    config = dataclasses.replace(points.CONFIG, discriminator_batch=64)
    _, curve = mpge_jax.ground_ensemble(
        points.SOURCE,
        small.stacked(points.policies(), points.policies()),
        small.stacked(log, other),
        config,
        jnp.stack([jax.random.key(0)] * 2),
        stopping=stopping,
        quiet=True,
    )
    for name in ("d_loss", "reward", "policy_kl"):
        np.testing.assert_allclose(curve[name][:, 0], curve[name][:, 1], rtol=1e-5, atol=1e-7)
    assert np.abs(curve["held_out_error"][:, 0] - curve["held_out_error"][:, 1]).min() > 0.01


@pytest.mark.parametrize("name", ["HalfCheetah", "InvertedPendulum"])
def test_a_lost_state_ends_its_episode(name):
    """The cheetah's task never terminates: what has become NaN would otherwise go on to the time limit."""
    env = small.env(name)
    obs = jnp.zeros((2, env.observation_size)).at[1, -1].set(jnp.nan)
    after = jax.vmap(lambda one: env.step(env.state_from_obs(one), jnp.zeros(env.action_size)))(obs)
    np.testing.assert_array_equal(np.isfinite(after.obs).all(axis=1), [True, False])
    np.testing.assert_array_equal(after.info["terminated"], [0.0, 1.0])
    np.testing.assert_array_equal(after.done, [0.0, 1.0])
