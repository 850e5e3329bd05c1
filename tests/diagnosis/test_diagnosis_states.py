"""Noise levels, smoothing and whitening against known answers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mpge_jax.diagnosis.noise import difference_noise, noise_level, quantum
from mpge_jax.diagnosis.smooth import Series, smooth


def test_divided_differences_cancel_polynomials_on_uneven_times():
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.005, 0.015, 60))
    for order in (4, 6, 8):
        smooth_part = np.polynomial.Polynomial(rng.standard_normal(order))(t)
        np.testing.assert_allclose(difference_noise(t, smooth_part, order), 0, atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.sampled_from([1e-5, 1e-4, 2e-3]), st.integers(0, 1000))
def test_noise_level_is_found_on_jittered_clocks(sigma, seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.008, 0.012, 600))
    y = np.sin(3 * t) + 0.3 * np.sin(11 * t) + sigma * rng.standard_normal(600)
    assert noise_level(t, y) == pytest.approx(sigma, rel=0.2)


def test_quantum_of_an_encoder_and_none_of_smooth_data():
    t = 0.01 * np.arange(500)
    step = 2 * np.pi / 4096
    assert quantum(np.round(np.sin(2 * t) / step) * step) == pytest.approx(step, rel=1e-6)
    assert quantum(np.sin(2 * t) + 1e-4 * np.random.default_rng(0).standard_normal(500)) == 0


def test_smoother_recovers_velocity_with_honest_uncertainty():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.008, 0.012, 400))
    y = np.sin(4 * t) + 1e-3 * rng.standard_normal(400)
    s = smooth([Series(t, y, None, 1e-3, 1.0)])[0]
    error = s.mean[20:-20, 1] - 4 * np.cos(4 * t[20:-20])
    deviation = np.sqrt(s.cov[20:-20, 1, 1])
    assert np.sqrt(np.mean(error**2)) < 0.06
    assert 0.3 < np.mean((error / deviation) ** 2) < 3.0
    assert np.sqrt(np.mean((s.mean[:, 0] - np.sin(4 * t)) ** 2)) < 1e-3
