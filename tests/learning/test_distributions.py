"""Densities, entropies and divergences against scipy and hand-computed numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from mpge_jax.learning import distributions

MEAN = jnp.array([[0.0, 1.0], [-2.0, 0.5]])
LOG_STD = jnp.array([[0.0, -1.0], [0.5, 0.25]])


def test_log_prob_by_hand():
    # One dimension, sigma = 1, one sigma away: -1/2 - 1/2 log(2 pi) = -1.4189385
    value = distributions.gaussian_log_prob(jnp.ones(1), jnp.zeros(1), jnp.zeros(1))
    assert float(value) == pytest.approx(-1.4189385, abs=1e-6)


def test_log_prob_and_entropy_against_scipy():
    x = jnp.array([[0.3, -0.7], [1.0, 2.0]])
    normal = stats.norm(MEAN, np.exp(LOG_STD))
    log_prob = distributions.gaussian_log_prob(x, MEAN, LOG_STD)
    np.testing.assert_allclose(log_prob, normal.logpdf(x).sum(axis=-1), rtol=1e-5)
    np.testing.assert_allclose(
        distributions.gaussian_entropy(LOG_STD), normal.entropy().sum(axis=-1), rtol=1e-6
    )


def test_kl_by_hand():
    # KL(N(1, 2^2) || N(0, 1)) = log(1/2) + (4 + 1) / 2 - 1/2 = 2 - log 2
    value = distributions.gaussian_kl(jnp.ones(1), jnp.full(1, np.log(2.0)), jnp.zeros(1), jnp.zeros(1))
    assert float(value) == pytest.approx(2.0 - np.log(2.0), abs=1e-6)


def test_kl_is_zero_only_for_equal_distributions():
    np.testing.assert_array_equal(distributions.gaussian_kl(MEAN, LOG_STD, MEAN, LOG_STD), np.zeros(2))
    assert np.all(distributions.gaussian_kl(MEAN, LOG_STD, MEAN + 0.1, LOG_STD) > 0)
    assert np.all(distributions.gaussian_kl(MEAN, LOG_STD, MEAN, LOG_STD + 0.1) > 0)


def test_kl_agrees_with_samples():
    mean_p, log_std_p = jnp.array([0.5, -0.5]), jnp.array([0.0, -0.5])
    mean_q, log_std_q = jnp.array([0.0, 0.0]), jnp.array([0.2, 0.1])
    shape = (100_000, 2)
    p = jnp.broadcast_to(mean_p, shape), jnp.broadcast_to(log_std_p, shape)
    q = jnp.broadcast_to(mean_q, shape), jnp.broadcast_to(log_std_q, shape)
    x = distributions.gaussian_sample(jax.random.key(0), *p)
    estimate = jnp.mean(distributions.gaussian_log_prob(x, *p) - distributions.gaussian_log_prob(x, *q))
    exact = distributions.gaussian_kl(mean_p, log_std_p, mean_q, log_std_q)
    assert float(exact) == pytest.approx(float(estimate), abs=0.01)


def test_tanh_log_prob_is_the_density_of_the_squashed_sample():
    # Change of variables: log p(y) = log N(atanh y) - log(1 - y^2), summed.
    action, log_prob, pre_tanh = distributions.tanh_gaussian_sample(jax.random.key(1), MEAN, LOG_STD)
    np.testing.assert_allclose(action, np.tanh(pre_tanh), rtol=1e-6)
    expected = stats.norm(MEAN, np.exp(LOG_STD)).logpdf(pre_tanh) - np.log1p(-(np.tanh(pre_tanh) ** 2))
    np.testing.assert_allclose(log_prob, expected.sum(axis=-1), rtol=1e-4)


def test_tanh_log_det_stays_finite_far_out():
    # log(1 - tanh(x)^2) -> 2 log 2 - 2 |x|; the naive form is log 0 from about 9 on.
    value = distributions.tanh_log_det(jnp.array([[50.0], [-50.0]]))
    np.testing.assert_allclose(value, np.full(2, 2 * np.log(2.0) - 100.0), rtol=1e-6)
