"""The action-transformation error, against values by hand."""

import copy
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.grounding import transform_error
from tests import small


@pytest.mark.parametrize("name", ["InvertedPendulum", "HalfCheetah", "HeavyCheetah"])
def test_a_target_that_no_change_of_actions_explains_has_no_truth(name):
    assert transform_error.truth_of(small.env(name)) is None


@pytest.mark.parametrize("more", [{"spec": lambda spec: None}, {"total_mass": 9.0}, {"delay": 1}])
def test_nor_has_one_that_changes_actions_and_more(more):
    target = copy.copy(small.env("BrokenCheetah"))
    target.variant = dataclasses.replace(target.variant, **more)
    assert transform_error.truth_of(target) is None


def test_the_truth_is_what_the_target_does_to_an_action():
    skew = transform_error.truth_of(small.env("SkewedPendulum"))
    broken = transform_error.truth_of(small.env("BrokenCheetah"))
    np.testing.assert_allclose([skew(jnp.array([a]))[0] for a in (-3.0, 0.0, 1.6)], [-1.5, 1.5, 3.0])
    np.testing.assert_allclose(broken(jnp.full(6, 0.7)), [0.0, 0.7, 0.7, 0.7, 0.7, 0.7])


@pytest.mark.parametrize(
    ("target", "source", "delta", "expected"),
    [
        # Uniform a in +-3: 1.5 where a < 1.5, which is 3/4 of the time, else 3 - a, 0.75 on average.
        ("SkewedPendulum", "InvertedPendulum", 0.0, 0.75 * 1.5 + 0.25 * 0.75),
        ("SkewedPendulum", "InvertedPendulum", 1.5, 0.0),
        # The mean of |a| for uniform a in +-1.
        ("BrokenCheetah", "HalfCheetah", 0.0, 0.5),
    ],
)
def test_mean_error_by_hand(target, source, delta, expected):
    env, truth = small.env(source), transform_error.truth_of(small.env(target))
    # A regular grid of actions, every component alike.
    grid = (np.arange(4000) + 0.5) / 2000 - 1.0
    action = jnp.asarray(grid[:, None] * np.asarray(env.action_high)[None], jnp.float32)
    observation = jnp.zeros((4000, env.observation_size))
    error = transform_error.mean_error(small.constant(env, delta), env, truth, observation, action)
    np.testing.assert_allclose(error, expected, atol=1e-3)


def test_along_rollouts_and_on_a_log():
    env, truth = small.env("InvertedPendulum"), transform_error.truth_of(small.env("SkewedPendulum"))
    log = small.log(log_std=-18.0)
    measure = jax.jit(
        lambda pi_g: (
            transform_error.in_rollouts(jax.random.key(0), pi_g, env, truth, 1024),
            transform_error.on_log(jax.random.key(1), pi_g, env, truth, log),
        )
    )
    along, on_log = measure(small.constant(env, 1.5))
    assert float(along) == pytest.approx(0.0, abs=1e-6)
    assert all(float(x) == pytest.approx(0.0, abs=1e-6) for x in on_log.values())
    along, on_log = measure(small.constant(env, 0.0))
    # 1.3125 with a standard deviation of 0.4 over 1,024 draws.
    assert float(along) == pytest.approx(1.3125, abs=0.06)
    assert float(on_log["error_uniform"]) == pytest.approx(1.3125, abs=0.06)
    # The mean over policies, each of which counts the same, of the error at its own actions.
    own = [np.asarray(log.action)[k, : int(log.count[k]), 0] for k in range(3)]
    expected = np.mean([np.mean(np.clip(a + 1.5, -3, 3) - a) for a in own])
    assert float(on_log["error_own"]) == pytest.approx(expected, abs=0.06)


def test_any_model_of_actions_can_be_judged():
    """As the mean error by hand: of one that adds 1.5, and of one that adds nothing."""
    env, truth = small.env("InvertedPendulum"), transform_error.truth_of(small.env("SkewedPendulum"))

    def shifted(by, observation, action, low, high):
        assert observation.shape[:1] == action.shape[:1]
        return jnp.clip(action + by, low[None], high[None])

    measure = jax.jit(
        lambda by: transform_error.in_rollouts(jax.random.key(0), by, env, truth, 4096, executed=shifted)
    )
    assert float(measure(1.5)) == pytest.approx(0.0, abs=1e-6)
    assert float(measure(0.0)) == pytest.approx(0.75 * 1.5 + 0.25 * 0.75, abs=0.03)
