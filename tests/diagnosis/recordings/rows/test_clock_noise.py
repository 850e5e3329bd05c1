"""Time stamps that are off: told by noise that grows with the speed, and counted as noise."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.whitening import robust_loss, row_scale, whitener_beside
from mpge_jax.diagnosis.evidence.null_distribution import floor as calibrated
from mpge_jax.diagnosis.recordings.noise_level import column_noise
from mpge_jax.diagnosis.recordings.rows.clock_noise import stamp_deviation
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from tests.diagnosis.machines import FINE_ARM, record
from tests.diagnosis.searches import prepared_of

TIME = np.arange(3000) / 100.0
NOISE = 1e-4


def _motion(t: np.ndarray) -> np.ndarray:
    """[T, 3] of three joints, fast ones and a slow one."""
    return np.stack([np.sin(3.0 * t), 1.5 * np.sin(2.0 * t + 0.3), 0.3 * np.sin(t)], 1)


def _stamped(rng: np.random.Generator, off: float) -> np.ndarray:
    return _motion(TIME + off * rng.standard_normal(TIME.size)) + NOISE * rng.standard_normal((TIME.size, 3))


def test_stamps_and_readings_are_told_apart_by_the_speed():
    rng = np.random.default_rng(0)
    q = [_stamped(rng, 1e-3) for _ in range(2)]
    columns = [[x[:, c] for x in q] for c in range(3)]
    told = stamp_deviation([TIME, TIME], columns)
    assert told == pytest.approx(1e-3, rel=0.1)
    for column in columns:
        assert column_noise([TIME, TIME], column, stamp=told)[0] == pytest.approx(NOISE, rel=0.25)
    assert column_noise([TIME, TIME], columns[0])[0] > 10 * NOISE


def _exact(rng: np.random.Generator) -> np.ndarray:
    return _stamped(rng, 0.0)


def _rattling(rng: np.random.Generator) -> np.ndarray:
    """The faster, the harder all of it vibrates, at a third of the rate of the rows."""
    v = np.gradient(_motion(TIME), TIME, axis=0)
    return _exact(rng) + 1e-3 * v * np.sin(2 * np.pi * 33.0 * TIME)[:, None]


def _one_joint(rng: np.random.Generator) -> np.ndarray:
    """One encoder errs the more the faster it turns, the others do not."""
    q = _exact(rng)
    q[:, 1] += 1e-3 * 3.0 * np.cos(2.0 * TIME + 0.3) * rng.standard_normal(TIME.size)
    return q


@pytest.mark.parametrize("recorded", [_exact, _rattling, _one_joint])
def test_what_only_looks_like_inexact_stamps_is_none(recorded):
    q = recorded(np.random.default_rng(1))
    assert stamp_deviation([TIME], [[q[:, c]] for c in range(3)]) == 0.0


@pytest.fixture(scope="module")
def late():
    """An arm as its model has it, each row measured up to milliseconds beside its stamp."""
    rng, out = np.random.default_rng(2), []
    for r in record(FINE_ARM, [4.0, 0.8], count=6, seconds=4.0, noise=3e-5):
        v = np.gradient(r.qpos, r.time, axis=0)
        out.append(replace(r, qpos=r.qpos + 2e-3 * v * rng.standard_normal((r.time.size, 1))))
    return out


def test_fast_rows_count_less_where_stamps_are_inexact(late):
    p = prepared_of(FINE_ARM, late)
    assert p.noise.stamp == pytest.approx(2e-3, rel=0.15)
    w = p.windows("train", 0.25, 20, seed=0)
    scale, nv = row_scale(p.noise, p.model, w), p.model.nv
    np.testing.assert_allclose(scale[..., :nv] ** 2, p.noise.qpos**2 + w.drift**2)
    assert np.isinf(scale[..., nv:]).all()
    speed = np.abs(np.diff(w.qpos, axis=1)).max(2) / np.diff(w.times, axis=1)
    drift = np.abs(w.drift[:, 1:]).max(2) / p.noise.stamp
    assert np.corrcoef(speed.ravel(), drift.ravel())[0, 1] > 0.7
    # a smoother that knows of it does not follow what stamps do
    moving = np.abs(p.train[0].states.qvel[:, 0]) > np.quantile(np.abs(p.train[0].states.qvel[:, 0]), 0.8)
    known = p.train[0].states.cov[:, 0, 0, 0]
    assert np.median(known[moving]) > 2.0 * np.median(known[~moving])


def test_inexact_stamps_are_no_missing_physics(late):
    few = Config(effects=("coulomb_friction", "armature", "encoder_offset"), jobs=1, quiet=True)
    d = diagnose(mujoco.MjSpec.from_string(FINE_ARM), late, few)
    assert d.verdict == "none" and any("time stamps are inexact" in x for x in d.warnings)


def test_a_true_model_leaves_noise_where_stamps_are_inexact(late):
    p, losses = prepared_of(FINE_ARM, late), []
    w = p.windows("train", 0.25, 20, seed=0)
    nothing = Run(NOTHING.hypothesis, NOTHING.theta)
    for windows in (w, replace(w, drift=np.zeros_like(w.drift))):
        white = whitener_beside(p.sim, NOTHING.hypothesis, NOTHING.theta, windows, p.noise, temper=False)
        losses.append(robust_loss(white.excess(white(p.sim.residuals([nothing], windows))[0])).mean())
    assert losses[0] == pytest.approx(1.0, abs=0.15) and losses[1] > 3.0
    # and so does what is simulated as if it were true
    floor = calibrated(p, NOTHING, 0.25)
    assert floor.loss == pytest.approx(1.0, abs=0.15)
