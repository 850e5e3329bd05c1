"""Methods to compare with: where their agents act, what they read, and what they say they took."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.methods import METHODS, corrected_reward, training
from experiments.methods.randomised import RANGES
from mpge_jax.grounding import transform_error
from mpge_jax.grounding.delta_action import delta
from mpge_jax.learning import sac
from tests import small
from tests.experiments.tiny import TINY, assert_moves_like, work


def test_domain_randomisation_takes_no_target_step_and_draws_machines(tmp_path, begun):
    made = METHODS["DR"].work(work("DR", tmp_path, seeds=(0, 1), samples=0))
    assert made.target_steps == [0, 0] and not METHODS["DR"].uses_samples
    (state,) = begun
    assert len(np.unique(np.asarray(state.env_state.info["machine"]))) > 1
    masses = np.asarray(state.env_state.data.given["body_mass"])[..., 1:]
    factors = masses / small.env("InvertedPendulum").model.body_mass[1:]
    assert RANGES.mass[0] <= factors.min() < factors.max() <= RANGES.mass[1]


def test_delta_follows_the_log_of_its_seed_then_trains_behind_what_it_learned(tmp_path, begun):
    one, two = small.log(size=2), small.log(size=2, steps=30)
    rows = 20
    logs = small.stacked(*(jax.tree.map(lambda x: x[:, :15] if x.ndim > 1 else x, log) for log in (one, two)))
    logs = logs.replace(count=jnp.full((2, 2), 10, jnp.int32))
    truth = transform_error.truth_of(small.env("SkewedPendulum"))
    given = work("delta", tmp_path, seeds=(0, 1), logs=logs, truth=truth)
    made = METHODS["delta"].work(given)
    following, trained = begun
    assert made.target_steps == [rows, rows]
    # 8 random steps; 6 updates are 3 iterations of 2 environments and 4 steps.
    assert [row["grounding_simulator_steps"] for row in made.extra] == [32, 32]
    # What is followed begins in states of that seed's log.
    seen = np.asarray(following.buffer.rows)[0, :8, :4]
    logged = np.asarray(logs.observation)[0, :, :10].reshape(-1, 4)
    assert np.abs(seen[:, None] - logged[None]).max(axis=2).min(axis=1)[:2].max() < 1e-6
    actor = jax.tree.map(lambda x: x[0], following.learner.actor)
    batch = np.asarray(trained.buffer.rows)[0, :8]
    observation, action, reached = batch[:, :4], batch[:, 4:5], batch[:, 6:10]
    assert made.extra[0]["transform_error"] == pytest.approx(
        float(transform_error.in_rollouts(
            given.cell.keys("error")[0], actor, given.source, truth,
            executed=lambda actor, s, a, low, high: jnp.clip(a + delta(actor, s, a), low[None], high[None]),
        ))
    )  # fmt: skip
    added = np.asarray(jax.vmap(lambda s, a: delta(actor, s, a))(observation, action))
    assert np.abs(added).max() > 1e-3
    wanted = small.step_from("InvertedPendulum", observation, np.clip(action + added, -3.0, 3.0))
    np.testing.assert_allclose(reached, wanted, atol=2e-5)


def test_darc_corrects_by_logged_transitions_after_a_tenth_of_the_updates(tmp_path, monkeypatch):
    log = small.stacked(small.log(size=2))
    handed = []

    def iterate(state, env, log, valid, config, classifiers, warm_up):
        handed.append(warm_up)
        return state, {"log": log, "valid": valid}

    def run_once(update, state, iterations, **options):
        handed.append(update(state)[1])
        return state, {}

    monkeypatch.setattr(corrected_reward.darc, "iterate", iterate)
    monkeypatch.setattr(training.loop, "run", run_once)
    given = work("DARC", tmp_path, logs=log)
    METHODS["DARC"].work(given)
    warm_up, metrics = handed
    assert warm_up == round(0.1 * TINY.tasks["InvertedPendulum"].agent_updates)
    rows = jax.tree.map(lambda x: np.asarray(x)[0, :40], metrics["log"])
    np.testing.assert_array_equal(metrics["valid"], [40])
    logged = jax.tree.map(lambda x: x[0], log).rows()
    np.testing.assert_array_equal(rows.obs, logged["observation"])
    np.testing.assert_array_equal(rows.action, logged["action"])
    np.testing.assert_array_equal(rows.next_obs, logged["next_observation"])


def test_darc_trains_in_the_simulator_from_the_source_policy(tmp_path, begun):
    log = small.stacked(small.log(size=2))
    given = work("DARC", tmp_path, logs=log)
    made = METHODS["DARC"].work(given)
    (state,) = begun
    assert_moves_like(state.agent, 0.0)
    assert made.target_steps == [40]
    first = jax.tree.map(lambda x: x[0, 0], given.sets)
    wanted = sac.warm_start(
        first.actor, first.critic, first.log_alpha, TINY.tasks["InvertedPendulum"].agent.sac
    )
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[0], b), state.agent.learner.actor, wanted.actor)
