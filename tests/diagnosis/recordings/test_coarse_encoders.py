"""Readings of coarse encoders at rest and in slow motion: they are rounded alike."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis.recordings.coarse_encoders import REACH, held_error

STEP = 2 * np.pi / 4096
ROUNDED = STEP / np.sqrt(12)


def test_readings_that_share_their_rounding_weigh_as_one():
    still = held_error(np.full(60, 0.3), STEP, ROUNDED)
    # 60 readings with errors of sqrt(60) roundings each have a mean that errs by one
    np.testing.assert_allclose(np.hypot(still, ROUNDED), np.sqrt(60) * ROUNDED)
    assert held_error(np.full(1000, 0.3), STEP, ROUNDED).max() == pytest.approx(ROUNDED * np.sqrt(2 * REACH))
    slow = held_error(STEP / 9 * np.arange(200), STEP, ROUNDED)[20:-20]
    # half a step is between four and five rows either way
    np.testing.assert_allclose(slow, ROUNDED * np.sqrt(8))


def test_fast_motion_noise_and_fine_encoders_share_none():
    assert not held_error(STEP * np.arange(50), STEP, ROUNDED).any()
    assert not held_error(np.full(50, 0.3), 0.0, 1e-4).any()
    assert not held_error(np.full(3, 0.3), STEP, ROUNDED).any()
    blurred = held_error(np.full(60, 0.3), STEP, np.hypot(ROUNDED, STEP))
    assert blurred.max() < 1e-8


@pytest.mark.parametrize("white", [0.0, 0.2, 0.4])
def test_what_the_mean_of_readings_errs_by_at_rest_is_what_is_said(white):
    rng, rows = np.random.default_rng(0), 100
    true = rng.uniform(0, 1, 2000) * STEP
    read = np.round((true[:, None] / STEP) + white * rng.standard_normal((2000, rows))) * STEP
    errs = (read.mean(1) - true).std()
    sigma = np.sqrt(ROUNDED**2 + (white * STEP) ** 2)
    said = np.hypot(sigma, held_error(np.full(rows, 0.3), STEP, sigma).max()) / np.sqrt(rows)
    assert errs == pytest.approx(said, rel=0.3)
