"""Noise levels, smoothing and whitening against known answers."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mpge_jax.diagnosis import Recording
from mpge_jax.diagnosis.machine.model import names_of
from mpge_jax.diagnosis.recordings.kalman_smoother import Series, smooth
from mpge_jax.diagnosis.recordings.measurement_noise import noise_of
from mpge_jax.diagnosis.recordings.noise_level import column_noise, difference_noise, noise_level, quantum
from mpge_jax.diagnosis.recordings.rows.clock_stamps import at_their_stamps, early
from mpge_jax.diagnosis.recordings.states import estimate
from tests.diagnosis.machines import PENDULUM


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
    assert noise_level(t, y) == pytest.approx(sigma, rel=0.35)


def test_quantum_of_an_encoder_and_none_of_smooth_data():
    t = 0.01 * np.arange(500)
    step = 2 * np.pi / 4096
    assert quantum([np.round(np.sin(2 * t) / step) * step]) == pytest.approx(step, rel=1e-6)
    assert quantum([np.sin(2 * t) + 1e-4 * np.random.default_rng(0).standard_normal(500)]) == 0


def test_an_encoder_that_rests_most_of_the_time_has_the_noise_of_its_step():
    t, step = 0.01 * np.arange(400), 2 * np.pi / 4096
    resting = step * (np.random.default_rng(0).random(400) < 0.05)
    still = np.zeros(400)
    noise, found = column_noise([t, t, t], [resting, still, still], rests=True)
    assert found == pytest.approx(step) and noise == pytest.approx(step / np.sqrt(12))
    # equal steps without rests are an even motion
    assert quantum([0.003 * np.arange(400)], rests=True) == 0
    # and a force that is switched is no encoder
    assert column_noise([t], [0.8 * np.sign(np.sin(2 * np.pi * t + 0.1))])[1] == 0


@pytest.mark.parametrize("pause", [6.0, 3600.0, 1e5, 1e7])
def test_a_pause_of_days_does_not_spoil_what_lies_beside_it(pause):
    t, rng = 0.01 * np.arange(60), np.random.default_rng(0)
    y = np.sin(3 * t) + 1e-4 * rng.standard_normal(t.size)
    s = smooth([Series(np.r_[t, t + pause], np.r_[y, y], None, np.full(2 * t.size, 1e-4), 1.0)])[0]
    truth = np.tile(3 * np.cos(3 * t), 2)
    deviation = np.sqrt(s.cov[:, 1, 1])
    assert (np.abs(s.mean[:, 1] - truth) < 5 * deviation).all() and (deviation[1:] < 0.02).all()


def test_smoother_recovers_velocity_with_honest_uncertainty():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.008, 0.012, 400))
    y = np.sin(4 * t) + 1e-3 * rng.standard_normal(400)
    s = smooth([Series(t, y, None, np.full(t.size, 1e-3), 1.0)])[0]
    error = s.mean[20:-20, 1] - 4 * np.cos(4 * t[20:-20])
    deviation = np.sqrt(s.cov[20:-20, 1, 1])
    assert np.sqrt(np.mean(error**2)) < 0.06
    assert 0.3 < np.mean((error / deviation) ** 2) < 3.0
    assert np.sqrt(np.mean((s.mean[:, 0] - np.sin(4 * t)) ** 2)) < 1e-3


def _swing(t):
    return np.sin(4 * t) + 0.2 * np.sin(9 * t)


def test_readings_taken_before_a_hiccup_of_the_clock_are_moved_on_to_their_stamps():
    rng = np.random.default_rng(0)
    step = np.full(600, 0.002)
    late = rng.choice(np.arange(10, 590), 40, replace=False)
    step[late] = 0.0055
    stamp = np.cumsum(step)
    read = stamp.copy()
    read[late[:25]] = stamp[late[:25] - 1] + 0.002
    position = _swing(read) + 1e-4 * rng.standard_normal(600)
    rows, moved = early(stamp, position, 1e-4)
    assert set(rows) <= set(late[:25])
    assert len(rows) >= 18  # near the turning points it makes no difference
    np.testing.assert_allclose(position[rows] + moved, _swing(stamp[rows]), atol=1e-3)
    rows, _ = early(stamp, _swing(stamp) + 1e-4 * rng.standard_normal(600), 1e-4)
    assert rows.size == 0


def test_an_impact_beside_a_hiccup_is_no_early_reading():
    t = np.cumsum(np.where(np.arange(200) % 20 == 7, 0.015, 0.01))
    assert early(t, np.abs(np.sin(5 * t)), 1e-5)[0].size == 0


@pytest.mark.parametrize(
    ("derived", "noise", "used"),
    [
        ("back", 1e-4, False),
        ("centre", 1e-4, False),
        ("gradient", 1e-4, False),
        ("back", 0.0, True),
        ("", 1e-4, True),
    ],
)
def test_velocities_computed_from_the_positions_are_not_used_twice(derived, noise, used):
    rng = np.random.default_rng(0)
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    t = 0.002 * np.arange(500)
    q = (_swing(t) + noise * rng.standard_normal(500))[:, None]
    v = 4 * np.cos(4 * t) + 1.8 * np.cos(9 * t) + 0.05 * rng.standard_normal(500)
    if derived == "back":
        v = np.r_[0.0, np.diff(q[:, 0]) / 0.002]
    elif derived == "centre":
        v = np.r_[0.0, (q[2:, 0] - q[:-2, 0]) / 0.004, 0.0]
    elif derived == "gradient":
        v = np.gradient(q[:, 0], t)
    estimated, _, warnings = estimate([Recording("r", t, q, v[:, None], None)], model, names_of(model))
    assert np.isfinite(estimated.qvel[0]) == used
    assert any("differences" in w for w in warnings) != used


def test_velocities_that_were_computed_before_seven_digits_were_written_are_known():
    """Where the clock jitters, differences of a coarse encoder's readings nearly cancel, and the digits decide."""
    rng = np.random.default_rng(0)
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    t = np.cumsum(0.005 * (1.0 + 0.03 * rng.standard_normal(2000)))
    step = 2 * np.pi / 16384
    q = step * np.round((0.02 * np.sin(t) - 0.29) / step)
    v = np.gradient(q, t)
    written = [np.array([float(f"{x:.7g}") for x in column]) for column in (t, q, v)]
    recorded = Recording("r", written[0], written[1][:, None], written[2][:, None], None)
    noise, _, warnings = estimate([recorded], model, names_of(model))
    assert np.isinf(noise.qvel[0]) and "differences" in warnings[0]


def test_derived_velocities_are_known_beside_readings_that_were_moved():
    rng = np.random.default_rng(0)
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    step = np.full(600, 0.002)
    late = np.arange(10, 590, 8)
    step[late] = 0.0055
    stamp = np.cumsum(step)
    read = stamp.copy()
    read[late] = stamp[late - 1] + 0.002
    q = (_swing(read) + 1e-4 * rng.standard_normal(600))[:, None]
    v = np.r_[0.0, np.diff(q[:, 0]) / step[1:]]
    recorded = [Recording("r", stamp, q, v[:, None], None)]
    moved, warnings = at_their_stamps(recorded, model, names_of(model))
    assert len(warnings) == 1 and (moved[0].qpos != q).any()
    noise, _ = noise_of(moved, model, names_of(model), recorded)
    assert np.isinf(noise.qvel[0])


def test_noise_of_a_column_with_holes():
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(500)
    y = np.sin(3 * t) + 1e-3 * rng.standard_normal(500)
    y[::31] = np.nan
    assert column_noise([t], [y])[0] == pytest.approx(1e-3, rel=0.2)
    assert np.isnan(column_noise([t], [np.full(500, np.nan)])[0])
