"""Inversion of the simulator on logged transitions, and the regression that makes a transformer of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mpge_jax
from mpge_jax.grounding import inversion, transform_error
from mpge_jax.grounding.inversion import InversionConfig
from mpge_jax.grounding.transformer import TransformerConfig
from tests import small

CONFIG = InversionConfig(TransformerConfig(hidden=(16,)), epochs=300, minibatch_size=16)


def inverted(source: str, target: str, steps: int):
    invert = jax.jit(lambda log: inversion.invert(small.env(source), log, CONFIG))
    return invert(small.log(target, steps=steps))


@pytest.fixture(scope="module")
def skew():
    return inverted("InvertedPendulum", "SkewedPendulum", 40)


@pytest.fixture(scope="module")
def broken():
    return inverted("HalfCheetah", "BrokenCheetah", 31)


def test_rows_are_the_logs_in_their_order(skew):
    log, size = small.log(), 14
    np.testing.assert_array_equal(skew.observation, np.asarray(log.observation).reshape(3 * size, 4))
    np.testing.assert_array_equal(skew.action, np.asarray(log.action).reshape(3 * size, 1))
    np.testing.assert_array_equal(np.asarray(skew.weight).reshape(3, size).sum(axis=1), log.count)


def test_the_skew_is_recovered_where_it_is_not_clipped(skew):
    valid = np.asarray(skew.weight) > 0
    action, explained = np.asarray(skew.action)[valid, 0], np.asarray(skew.explained)[valid, 0]
    assert (action < 1.4).sum() > 20
    np.testing.assert_allclose(explained, np.clip(action + 1.5, -3.0, 3.0), atol=5e-3)
    assert np.asarray(skew.misfit)[valid].max() < 1e-2


def test_the_dead_motor_is_recovered_and_the_others_are_left_alone(broken):
    valid = np.asarray(broken.weight) > 0
    assert valid.sum() == 31 and len(valid) == 33
    error = np.abs(np.asarray(broken.explained) - np.asarray(broken.action) * np.array([0, 1, 1, 1, 1, 1]))[
        valid
    ]
    assert np.median(error) < 1e-3
    assert np.quantile(error, 0.9) < 2e-2
    assert np.asarray(broken.explained)[valid].min() >= -1.0


def test_regression_gives_a_transformer_near_the_truth(skew):
    env, truth = small.env("InvertedPendulum"), transform_error.truth_of(small.env("SkewedPendulum"))
    pi_g = jax.jit(lambda data: inversion.regress(jax.random.key(0), data, CONFIG))(skew)
    assert float(transform_error.mean_error(pi_g, env, truth, skew.observation, skew.action)) < 0.15
    np.testing.assert_array_equal(pi_g.params["log_std"], [CONFIG.transformer.init_log_std])


def test_rows_that_diverged_and_padding_teach_nothing(skew):
    regress = jax.jit(lambda data: inversion.regress(jax.random.key(0), data, CONFIG))
    padding = np.asarray(skew.weight) == 0
    assert padding.sum() == 2
    lost = skew.replace(
        misfit=jnp.where(padding, jnp.nan, skew.misfit).at[3].set(jnp.nan),
        explained=jnp.where(padding[:, None], 1e3, skew.explained).at[3].set(-1e3),
    )
    env, truth = small.env("InvertedPendulum"), transform_error.truth_of(small.env("SkewedPendulum"))
    pi_g = regress(lost)
    assert float(transform_error.mean_error(pi_g, env, truth, skew.observation, skew.action)) < 0.15


def test_what_padding_holds_does_not_matter(skew):
    log = small.log()
    valid = np.arange(log.observation.shape[1])[None] < np.asarray(log.count)[:, None]
    fill = lambda x: jnp.where(valid[..., None], x, jnp.nan)  # noqa: E731
    spoilt = log.replace(
        observation=fill(log.observation),
        action=fill(log.action),
        next_observation=fill(log.next_observation),
    )
    found = jax.jit(lambda data: inversion.invert(small.env("InvertedPendulum"), data, CONFIG))(spoilt)
    jax.tree.map(np.testing.assert_array_equal, found, skew)


def test_logs_that_do_not_fit_are_named():
    env, keys = small.env("InvertedPendulum"), jax.random.split(jax.random.key(0), (2, 1))
    with pytest.raises(ValueError, match="2 keys ask for as many target logs"):
        mpge_jax.invert_ensemble(env, small.stacked(small.log()), CONFIG, keys)
    with pytest.raises(ValueError, match=r"keys of shape \[logs, members\], got \(2,\)"):
        mpge_jax.invert_ensemble(env, small.stacked(small.log(), small.log()), CONFIG, keys[:, 0])
    broken = small.log().replace(observation=small.log().observation.at[0, 1].set(jnp.nan))
    with pytest.raises(ValueError, match="observation of policy 0 is not finite in row 1"):
        mpge_jax.invert_ensemble(env, small.stacked(small.log(), broken), CONFIG, keys)


def test_the_members_of_an_inversion_start_from_different_networks():
    logs = small.stacked(small.log())
    keys = jax.random.split(jax.random.key(0), (1, 2))
    members, misfit = mpge_jax.invert_ensemble(small.env("InvertedPendulum"), logs, CONFIG, keys)
    assert misfit.shape == (1,) and float(misfit.max()) < 1e-2
    (kernel,) = members.params["mean"]["params"]["Dense_0"]["kernel"]
    assert kernel.shape == (2, 5, 16)
    assert np.abs(np.asarray(kernel[0]) - np.asarray(kernel[1])).max() > 0.1


@pytest.mark.parametrize("name", ["iterations", "difference", "learning_rate", "epochs", "minibatch_size"])
def test_a_configuration_out_of_range_is_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be positive, got 0"):
        InversionConfig(**{name: 0})
    with pytest.raises(ValueError, match="weight_decay must not be negative"):
        InversionConfig(weight_decay=-1.0)
