"""The action transformer: clipping by hand, log-probabilities, shapes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from mpge_jax.grounding import transformer

OBS, ACT = 3, 2
LOW, HIGH = jnp.array([-1.0, -3.0]), jnp.array([1.0, 3.0])


def make(seed=0, init_log_std=0.0):
    config = transformer.TransformerConfig(hidden=(8, 8), init_log_std=init_log_std)
    return transformer.init(jax.random.key(seed), OBS, ACT, config)


def with_mean(policy, mean):
    """`policy` with a mean residual that is `mean` whatever the input."""
    last = policy.params["mean"]["params"]["Dense_2"]
    layers = policy.params["mean"]["params"] | {
        "Dense_2": {"kernel": jnp.zeros_like(last["kernel"]), "bias": jnp.asarray(mean)}
    }
    return policy.replace(params=policy.params | {"mean": {"params": layers}})


@pytest.mark.parametrize(
    ("action", "delta", "expected"),
    [
        ([0.5, 0.0], [0.25, -1.5], [0.75, -1.5]),  # nothing to clip
        ([0.5, 2.0], [0.75, 4.0], [1.0, 3.0]),  # the sum is clipped to [low, high]
        ([0.5, 2.0], [-9.0, -9.0], [-1.0, -3.0]),  # both clips, same end
        # An action from outside the box: delta is first clipped to +-2 and +-6, so -5 + 2 = -3 and
        # 10 - 6 = 4, then the sums to -1 and 3. With the second clip alone it would be 1 and -3.
        ([-5.0, 10.0], [10.0, -20.0], [-1.0, 3.0]),
    ],
)
def test_transform_by_hand(action, delta, expected):
    result = transformer.transform(jnp.array(delta), jnp.array(action), LOW, HIGH)
    np.testing.assert_allclose(result, expected)


def test_true_transform_of_the_skewed_pendulum():
    # +1.5, then clip to +-3
    low, high = jnp.array([-3.0]), jnp.array([3.0])
    action = jnp.array([[-3.0], [0.0], [1.0], [2.5]])
    result = transformer.transform(jnp.full((4, 1), 1.5), action, low, high)
    np.testing.assert_allclose(result[:, 0], [-1.5, 1.5, 2.5, 3.0])


def test_log_prob_is_of_the_unclipped_delta():
    policy = with_mean(make(init_log_std=1.5), [0.5, -0.5])
    observation, action = jnp.zeros((500, OBS)), jnp.zeros((500, ACT))
    delta, log_prob = transformer.sample(policy, jax.random.key(0), observation, action)
    assert float(jnp.abs(delta[:, 0]).max()) > 2.0  # beyond +-(high - low): a clipped one would show
    expected = stats.norm([0.5, -0.5], np.exp(1.5)).logpdf(delta).sum(axis=-1)
    np.testing.assert_allclose(log_prob, expected, rtol=1e-5)
    assert np.asarray(delta).mean(axis=0) == pytest.approx([0.5, -0.5], abs=0.6)
    assert np.asarray(delta).std(axis=0) == pytest.approx(np.full(2, np.exp(1.5)), rel=0.1)


def test_deterministic_applies_the_mean():
    policy = with_mean(make(), [0.25, -9.0])
    result = transformer.deterministic(policy, jnp.zeros(OBS), jnp.array([0.5, 1.0]), LOW, HIGH)
    np.testing.assert_allclose(result, [0.75, -3.0])


def test_starts_as_almost_the_identity():
    policy = make(init_log_std=-1.5)
    observation = 10.0 * jax.random.normal(jax.random.key(1), (64, OBS))
    action = jax.random.uniform(jax.random.key(2), (64, ACT), minval=-1.0)
    mean, log_std = transformer.distribution(policy, observation, action)
    assert 0.0 < float(jnp.abs(mean).max()) < 0.1
    np.testing.assert_array_equal(log_std, np.full((64, ACT), -1.5, np.float32))


def test_depends_on_the_observation_and_on_the_action():
    policy = make()
    at = transformer.distribution(policy, jnp.zeros(OBS), jnp.zeros(ACT))[0]
    assert not np.allclose(at, transformer.distribution(policy, jnp.ones(OBS), jnp.zeros(ACT))[0], atol=1e-5)
    assert not np.allclose(at, transformer.distribution(policy, jnp.zeros(OBS), jnp.ones(ACT))[0], atol=1e-5)


def test_inputs_are_raw_unless_a_scale_is_given():
    policy = make()
    observation, action = jnp.array([[1.0, 2.0, 3.0]]), jnp.array([[4.0, 5.0]])
    np.testing.assert_array_equal(
        transformer.network_inputs(policy, observation, action), [[1.0, 2.0, 3.0, 4.0, 5.0]]
    )
    scaled = policy.replace(input_mean=jnp.arange(5.0), input_std=jnp.array([1.0, 2.0, 1.0, 1.0, 0.5]))
    np.testing.assert_array_equal(
        transformer.network_inputs(scaled, observation, action), [[1.0, 0.5, 1.0, 1.0, 2.0]]
    )
    np.testing.assert_array_equal(
        transformer.distribution(scaled, observation, action)[0],
        transformer.apply(policy.params, jnp.array([[1.0, 0.5, 1.0, 1.0, 2.0]]))[0],
    )


def test_leading_axes_are_free():
    policy = make()
    observation = jax.random.normal(jax.random.key(0), (4, 5, OBS))
    action = jax.random.normal(jax.random.key(1), (4, 5, ACT))
    many = transformer.deterministic(policy, observation, action, LOW, HIGH)
    one = transformer.deterministic(policy, observation[2, 3], action[2, 3], LOW, HIGH)
    assert many.shape == (4, 5, ACT)
    np.testing.assert_allclose(many[2, 3], one, rtol=1e-5)
    delta, log_prob = transformer.sample(policy, jax.random.key(2), observation, action)
    assert (delta.shape, log_prob.shape) == ((4, 5, ACT), (4, 5))


def test_members_of_an_ensemble_vmap():
    members = [make(seed) for seed in range(3)]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *members)
    observation, action = jnp.ones(OBS), jnp.ones(ACT)
    together = jax.vmap(transformer.distribution, in_axes=(0, None, None))(stacked, observation, action)
    for i, member in enumerate(members):
        np.testing.assert_allclose(
            together[0][i], transformer.distribution(member, observation, action)[0], rtol=1e-5, atol=1e-7
        )


def test_another_tasks_transformer_is_refused():
    with pytest.raises(ValueError, match=r"of 5 numbers together, got 4 \+ 2; was it made for another task"):
        transformer.distribution(make(), jnp.zeros(4), jnp.zeros(2))


def test_configuration_is_checked():
    with pytest.raises(ValueError, match=r"positive width, got \(64, 0\)"):
        transformer.TransformerConfig(hidden=(64, 0))
