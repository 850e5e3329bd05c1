"""Readings of coarse encoders at rest and in slow motion: they are rounded alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.whitening import row_scale
from mpge_jax.diagnosis.evidence import null_distribution
from mpge_jax.diagnosis.recordings.noise_level import REACH, held_error
from tests.diagnosis.machines import FINE_PENDULUM, record
from tests.diagnosis.searches import prepared_of

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


@pytest.fixture(scope="module")
def coarse() -> Prepared:
    """A pendulum that swings and comes to rest, read by an encoder of 512 steps a turn."""
    damped = FINE_PENDULUM.replace('damping="0.02"', 'damping="0.6"')
    step = 2 * np.pi / 512
    recordings = record(damped, 0.15, noise=1e-6)
    return prepared_of(damped, [replace(r, qpos=np.round(r.qpos / step) * step) for r in recordings])


def test_windows_and_states_hold_that_readings_are_rounded_alike(coarse):
    w = coarse.windows("train", 0.25, 40)
    assert coarse.noise.quantum[0] == pytest.approx(2 * np.pi / 512)
    assert w.held.max() > 2.0 * coarse.noise.qpos[0]
    scale = row_scale(coarse.noise, coarse.model, w)[..., :1]
    np.testing.assert_allclose(scale**2, coarse.noise.qpos[0] ** 2 + w.held**2)
    # a mean of readings at rest is known no better than a rounding is
    each = np.concatenate([s.states.cov[:, 0, 0, 0] for s in coarse.train])
    assert np.sqrt(each.max()) > 0.8 * coarse.noise.quantum[0] / np.sqrt(12)


def test_what_noise_leaves_is_told_with_readings_rounded_as_they_are(coarse, monkeypatch):
    told = []
    own = null_distribution.smoothed

    def smoothed(segments, model, noise, jumps):
        told.extend(segments)
        return own(segments, model, noise)

    monkeypatch.setattr(null_distribution, "smoothed", smoothed)
    assert null_distribution.floor(coarse, NOTHING, 0.25).loss < 1.5
    for r in told:
        code = (r.qpos - r.qpos[0]) / coarse.noise.quantum[0]
        np.testing.assert_allclose(code, np.round(code), atol=1e-6)
    assert told


def test_a_missing_first_reading_takes_no_other_with_it(coarse, monkeypatch):
    told, cut = [], Prepared.windows

    class Told(Exception):
        """What is told from here on is another matter."""

    def windows(p, *args, **kwargs):
        w = cut(p, *args, **kwargs)
        w.qpos[:, 0] = np.nan
        return w

    def smoothed(segments, _model, _noise, _jumps):
        told.extend(segments)
        raise Told

    monkeypatch.setattr(Prepared, "windows", windows)
    monkeypatch.setattr(null_distribution, "smoothed", smoothed)
    with pytest.raises(Told):
        null_distribution.floor(coarse, NOTHING, 0.25)
    assert told and all(np.isnan(r.qpos[0]).all() and np.isfinite(r.qpos[1:]).all() for r in told)
