"""Readings that no motion gives are found; kinks, stale readings and flickering encoders are motion or measurement."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.machine.model import names_of
from mpge_jax.diagnosis.recordings.reader import read
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.rows.stray_readings import stray_rows

ARM = mujoco.MjModel.from_xml_string(
    """<mujoco><worldbody><body><joint name="elbow" axis="0 1 0"/><geom size="0.1" pos="0.3 0 0"/></body></worldbody>
    <actuator><motor name="motor" joint="elbow"/></actuator></mujoco>"""
)


def swing(rng: np.random.Generator, rows: int = 800, noise: float = 1e-4):
    time = np.cumsum(rng.uniform(0.004, 0.006, rows))
    return time, np.sin(3 * time) + 0.3 * np.sin(11 * time) + noise * rng.standard_normal(rows)


def test_single_strays_are_found_and_nothing_else():
    rng = np.random.default_rng(0)
    time, value = swing(rng)
    assert not stray_rows(time, value).any()
    wrong = np.array([40, 45, 300, 620])
    value[wrong] += [0.05, -0.4, 0.1, 0.08]
    assert np.flatnonzero(stray_rows(time, value)).tolist() == wrong.tolist()


@pytest.mark.parametrize("seed", range(4))
def test_strays_between_unevenly_spaced_rows_are_found(seed):
    """Stamps a third of the usual step off: cubics through close rows miss by more than the stray itself does."""
    rng = np.random.default_rng(seed)
    time = 0.005 * (np.arange(1800) + rng.uniform(-0.35, 0.35, 1800))
    time = time[rng.random(1800) > 0.02]
    value = np.round((np.sin(3 * time) + 1.5e-4 * rng.standard_normal(time.size)) / 5e-5) * 5e-5
    assert not stray_rows(time, value).any()
    wrong = np.arange(20, time.size - 20, 60)
    value[wrong] += rng.choice([-1, 1], wrong.size) * rng.uniform(0.1, 0.5, wrong.size)
    assert np.flatnonzero(stray_rows(time, value)).tolist() == wrong.tolist()


@pytest.mark.parametrize("noise", [0.0, 1e-5, 1e-3])
def test_an_impact_is_motion(noise):
    """A ball that bounces off the floor: its velocity jumps between rows, or in a row."""
    rng = np.random.default_rng(1)
    for phase in np.linspace(0, 0.005, 9):
        time = phase + 0.005 * np.arange(400)
        height = np.abs(np.sin(5 * time)) + noise * rng.standard_normal(400)
        assert not stray_rows(time, height).any()


def test_a_reading_that_is_older_than_its_stamp_is_no_stray():
    time, value = swing(np.random.default_rng(2))
    value[200] = value[199] + 0.1 * (value[200] - value[199])
    assert not stray_rows(time, value).any()


def test_an_encoder_that_flickers_by_a_step_is_no_stray():
    rng = np.random.default_rng(3)
    step = 2 * np.pi / 4096
    value = np.zeros(600)
    value[rng.integers(10, 590, 30)] = step
    assert not stray_rows(0.005 * np.arange(600), value).any()


def test_what_is_common_is_how_a_column_is_measured():
    time, value = swing(np.random.default_rng(4))
    value[10:790:20] += 0.1
    assert not stray_rows(time, value).any()
    assert not stray_rows(time[:8], value[:8]).any()


def test_a_recording_is_read_without_its_strays_and_says_so():
    rng = np.random.default_rng(5)
    time, value = swing(rng)
    stray = value.copy()
    stray[[100, 500]] += [0.2, -0.4]
    given = Recording("run", time, stray[:, None], None, np.zeros((800, 1)))
    (read_,) = read([given], ARM, names_of(ARM))
    np.testing.assert_allclose(read_.qpos[:, 0], value, atol=2e-3)
    assert (np.delete(read_.qpos[:, 0], [100, 500]) == np.delete(stray, [100, 500])).all()
    assert any("jump away and back" in w and "2 of joint elbow (of 800 rows)" in w for w in read_.warnings)
    (clean,) = read([Recording("run", time, value[:, None], None, np.zeros((800, 1)))], ARM, names_of(ARM))
    assert (clean.qpos[:, 0] == value).all() and not any("jump away" in w for w in clean.warnings)
