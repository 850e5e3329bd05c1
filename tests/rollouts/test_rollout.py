"""Rollout policies: any pure function of parameters, observation and key."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.rollouts import target_log
from mpge_jax.rollouts.rollout import RolloutPolicies
from tests import points, small


def test_a_plain_function_records_the_target():
    log = points.log()
    observation, action, following = log.rows().values()
    np.testing.assert_allclose(
        following, 0.8 * observation + np.clip(np.clip(action, -1, 1) + points.SHIFT, -1, 1), rtol=1e-6
    )
    slopes, offsets = np.asarray(points.policies().params).T
    mean = slopes[:, None, None] * np.asarray(log.observation) + offsets[:, None, None]
    noise = np.asarray(log.action) - mean
    assert 0.05 < noise.std() < 0.15 and abs(noise.mean()) < 0.05
    # Every draw is another.
    assert len(np.unique(noise)) == noise.size


def test_a_set_of_sac_policies_samples_its_actions():
    chosen = small.policy_set().rollout
    assert chosen.size == 3
    one = jax.tree.map(lambda x: x[0], chosen.params)
    first, second = (chosen.act(one, jnp.zeros(4), jax.random.key(seed)) for seed in (0, 1))
    assert first.shape == (1,) and float(first[0]) != float(second[0])


@pytest.mark.parametrize(
    ("policies", "message"),
    [
        (points.policies().replace(params=jnp.zeros(())), "needs a first axis of one length, K"),
        (
            RolloutPolicies(params={"a": jnp.zeros((2, 1)), "b": jnp.zeros((3, 1))}, act=points.act),
            "needs a first axis of one length, K",
        ),
        (
            RolloutPolicies(params=jnp.zeros((2, 1)), act=lambda p, obs, key: jnp.zeros(3)),
            r"give actions of shape \(3,\), Point wants an array of shape \(1,\); .* \(here 2\)",
        ),
        (
            RolloutPolicies(params=jnp.zeros((2, 1)), act=lambda p, obs, key: [0.0]),
            r"give a list, Point wants an array",
        ),
        (
            RolloutPolicies(params=jnp.zeros((2, 5)), act=lambda p, obs, key: p @ obs),
            r"cannot act on the 1 observations of Point \(TypeError: ",
        ),
    ],
)
def test_policies_that_do_not_fit_are_told_in_one_sentence(policies, message):
    with pytest.raises(ValueError, match=message) as error:
        target_log.collect(jax.random.key(0), points.TARGET, policies, 10)
    assert "\n" not in str(error.value)


def test_a_budget_is_a_whole_number():
    with pytest.raises(ValueError, match=r"a budget of target steps is a whole number, not 10\.5"):
        # without the types that these tests check
        inspect.unwrap(target_log.collect)(jax.random.key(0), points.TARGET, points.policies(), 10.5)
