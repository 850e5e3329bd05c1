"""The delta action model: rows of a log, following them, and a known shift of actions that is recovered."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.grounding.delta_action import DeltaConfig, DeltaEnv, TrackingEnv, delta
from mpge_jax.learning import agent
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.sac import SACConfig
from mpge_jax.rollouts import target_log
from mpge_jax.rollouts.rollout import RolloutPolicies
from mpge_jax.rollouts.target_log import TargetLog
from mpge_jax.rollouts.trajectories import trajectories
from tests import small
from tests.probes import point

SHIFT = 0.4


def log_of(shift: float, steps: int = 400) -> TargetLog:
    """Uniformly random actions in +-0.5, in the point that is pushed."""

    def act(params, obs, key):
        return params + jax.random.uniform(key, (1,), minval=-0.5, maxval=0.5)

    policies = RolloutPolicies(params=jnp.zeros((2, 1)), act=act)
    return target_log.collect(jax.random.key(0), point(shift), policies, steps)


def test_the_right_delta_follows_and_another_is_paid_less():
    rows = trajectories(log_of(SHIFT))
    env = TrackingEnv(point(), rows, DeltaConfig(horizon=5, penalty=0.0))
    state = jax.vmap(env.reset)(jax.random.split(jax.random.key(1), 16))
    np.testing.assert_allclose(state.obs[:, 0], rows.observation[state.info["row"], 0])
    np.testing.assert_allclose(state.obs[:, 1], rows.action[state.info["row"], 0])
    step = jax.jit(jax.vmap(env.step))
    right = step(state, jnp.full((16, 1), SHIFT))
    np.testing.assert_allclose(right.reward, np.ones(16), atol=1e-5)
    np.testing.assert_allclose(right.obs[:, 0], rows.following[state.info["row"], 0], atol=1e-6)
    # exp(-|e / sigma|) by hand, where the sum of actions stays inside of the box.
    wrong = step(state, jnp.full((16, 1), SHIFT - 0.1))
    logged = rows.action[state.info["row"], 0]
    error = jnp.clip(logged + SHIFT, -1, 1) - jnp.clip(logged + SHIFT - 0.1, -1, 1)
    np.testing.assert_allclose(wrong.reward, jnp.exp(-jnp.abs(error / rows.scale[0])), rtol=1e-4)
    # It goes on from where it is, with the next logged action; the horizon ends it.
    for _ in range(4):
        assert not np.any(right.done * (1 - rows.last[state.info["row"]]))
        state, right = right, step(right, jnp.full((16, 1), SHIFT))
    assert np.all(right.done == 1)
    np.testing.assert_array_equal(right.info["terminated"], rows.last[state.info["row"]])


def test_where_the_log_ends_nothing_follows():
    """At its last row no next action was logged, so no value of one may be asked for; at the horizon it may."""
    rows = trajectories(log_of(SHIFT))
    last = int(np.flatnonzero(np.asarray(rows.last))[0])
    env = TrackingEnv(point(), rows, DeltaConfig(horizon=1))
    state = env.reset(jax.random.key(0))
    for row, ends in ((last, (1.0, 0.0)), (last - 1, (0.0, 1.0))):
        inner = point().state_from_obs(rows.observation[row])
        at = state.replace(data=inner, info={**state.info, "row": jnp.asarray(row)})
        after = env.step(at, jnp.array([SHIFT]))
        assert (float(after.info["terminated"]), float(after.info["truncated"])) == ends
        assert float(after.reward) > 0.9


def test_a_lost_trajectory_ends_without_reward():
    rows = trajectories(log_of(SHIFT))
    env = TrackingEnv(point(), rows, DeltaConfig(lost=1e-6, penalty=0.5, reach=0.5))
    state = env.step(env.reset(jax.random.key(0)), jnp.array([-1.0]))
    assert (float(state.info["terminated"]), float(state.done)) == (1.0, 1.0)
    assert float(state.reward) == pytest.approx(-0.5)


def test_a_known_shift_of_actions_is_recovered():
    """As its publication says of the delta action: added in the simulator, it makes up for the difference."""
    env = TrackingEnv(point(), trajectories(log_of(SHIFT)), DeltaConfig(horizon=4, penalty=0.0))
    sac = SACConfig(
        hidden=(32, 32), batch_size=64, actor_lr=3e-3, critic_lr=3e-3, alpha_lr=3e-3, target_entropy=-4.0
    )
    config = AgentConfig(sac, num_envs=16, steps_per_iteration=16, updates_per_iteration=64, random_steps=512,
                         buffer_capacity=20_000)  # fmt: skip
    state = jax.jit(lambda key: agent.init(key, env, config))(jax.random.key(2))
    iterate = jax.jit(lambda state: agent.iterate(state, env, config)[0], donate_argnums=0)
    for _ in range(24):
        state = iterate(state)
    pairs = jax.random.uniform(jax.random.key(3), (200, 2), minval=-0.5, maxval=0.5)
    found = jax.vmap(lambda x: delta(state.learner.actor, x[:1], x[1:]))(pairs)
    assert float(jnp.mean(jnp.abs(found - SHIFT))) < 0.08


def test_the_simulator_with_delta_executes_the_sum_and_charges_what_was_asked():
    plain = small.env("HalfCheetah")
    actor = small.policy_set("HalfCheetah", size=1).actor
    inputs = plain.observation_size + plain.action_size
    kernel = jnp.zeros((inputs, 8))
    first = {"kernel": kernel, "bias": jnp.zeros(8)}
    last = {"kernel": jnp.zeros((8, 12)), "bias": jnp.arctanh(jnp.array([0.25] * 6 + [0.0] * 6))}
    network = {"params": {"Dense_0": first, "Dense_1": last}}
    model = actor.replace(params=network, action_scale=jnp.ones(6), action_middle=jnp.zeros(6))
    env = DeltaEnv(plain, model)
    state, action = plain.reset(jax.random.key(0)), jnp.array([0.9, -0.5, 0.0, 0.1, -0.9, 0.3])
    after = env.step(env.reset(jax.random.key(0)), action)
    wanted = plain.step(state, jnp.clip(action + 0.25, -1.0, 1.0), charged=action)
    np.testing.assert_allclose(after.obs, wanted.obs, atol=1e-5)
    np.testing.assert_allclose(after.metrics["reward_control"], -0.1 * jnp.sum(action**2), rtol=1e-5)


@pytest.mark.parametrize("wrong", [{"horizon": 0}, {"lost": 0.0}, {"penalty": -1.0}])
def test_values_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError):
        DeltaConfig(**wrong)
