"""Smoothed motions, and draws of what measurements leave open of them."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.recordings.kalman_smoother import CHUNK, Series, errors_drawn, smooth

DRAWS = 200


def test_draws_scatter_about_the_smoothed_motion_as_much_as_it_is_uncertain():
    rng, time = np.random.default_rng(0), np.arange(0.0, 1.5, 0.01)
    position = np.sin(9.0 * time) + 1e-3 * rng.standard_normal(time.size)
    velocity = 9.0 * np.cos(9.0 * time) + 0.02 * rng.standard_normal(time.size)
    for v in (None, velocity):
        series = Series(time, position, v, np.full(time.size, 1e-3), 0.02)
        (told,) = smooth([series])
        away = errors_drawn([series, series], DRAWS, rng)[1]
        spread = np.sqrt(np.diagonal(told.cov, axis1=1, axis2=2))
        middle = slice(20, -20)
        assert (np.abs(away.mean(0)) < 5.0 * spread / np.sqrt(DRAWS))[middle].all()
        ratio = (away.std(0) / spread)[middle].mean(0)
        np.testing.assert_allclose(ratio, 1.0, atol=0.15)
        # stretches that are smoothed apart meet without a jump
        steps = np.diff(away[..., 1], axis=1).std(0)
        assert steps[CHUNK - 1] < 1.3 * np.median(steps)
