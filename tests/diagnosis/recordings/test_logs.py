"""Logs as machines write them: clocks since 1970, fast rows, pauses, resting encoders, files in counting order."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording, diagnose
from mpge_jax.diagnosis.drives.drive_law import PAUSE, log_of
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.null_distribution import floor
from mpge_jax.diagnosis.machine.model import names_of
from mpge_jax.diagnosis.recordings.column_map import apply
from mpge_jax.diagnosis.recordings.measurement_noise import noise_of
from mpge_jax.diagnosis.recordings.noise_level import quantum
from mpge_jax.diagnosis.recordings.reader import load_recordings
from mpge_jax.diagnosis.recordings.recorded_velocities import wrong
from mpge_jax.diagnosis.recordings.recording import from_zero
from mpge_jax.diagnosis.recordings.rows.full_turns import unwrapped
from mpge_jax.diagnosis.recordings.states import estimate
from mpge_jax.diagnosis.recordings.three_parts import PARTS
from mpge_jax.diagnosis.report.next_experiment import _windows
from tests.diagnosis.machines import ARM, PENDULUM, record
from tests.diagnosis.searches import prepared_of

SPINNER = """<mujoco><worldbody><body><joint name="hinge" axis="0 0 1"/><geom size=".1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("rate", [100, 500])
def test_the_floor_of_fast_logs_is_that_of_slow_ones(rate):
    """Commands averaged over the rows between those that are compared would count as noise."""
    p = prepared_of(PENDULUM, record(PENDULUM, 0.8, rate=rate, noise=1e-5))
    assert floor(p, NOTHING, p.config.decide_s).losses.max() < 2.0


@pytest.mark.parametrize("origin", [0.0, 1.7e9])
def test_commands_are_found_on_jittered_clocks_of_any_origin(origin):
    rng = np.random.default_rng(0)
    time = origin + np.cumsum(1e-3 * (1 + rng.uniform(-0.1, 0.1, 20_000)))
    ctrl, dt = np.arange(time.size, dtype=float)[:, None] % 2.0, 2.5e-4
    zero = np.zeros((time.size, 1))
    r = from_zero(Recording("run", time, zero, zero, ctrl, ctrl))
    assert r.origin + r.time[-1] == time[-1]
    p = prepared_of(PENDULUM, record(PENDULUM, 0.8))
    source = dataclasses.replace(p.train[0], recording=r, states=_still(time.size))
    log = log_of(source, p.ctx, 0, dt, 0)
    np.testing.assert_array_equal(log.u[0, log.at], ctrl[:, 0])
    np.testing.assert_allclose(log.time, time)


def _still(rows: int):
    from mpge_jax.diagnosis.recordings.states import States

    zero = np.zeros((rows, 1))
    return States(zero, zero, zero, np.zeros((rows, 1, 2, 2)))


def test_a_pause_in_a_log_of_forces_costs_nothing():
    time = np.concatenate([np.arange(100), 1e6 + np.arange(100)]) * 1e-2
    zero = np.zeros((time.size, 1))
    p = prepared_of(PENDULUM, record(PENDULUM, 0.8))
    r = Recording("run", time, zero, zero, zero, zero)
    source = dataclasses.replace(p.train[0], recording=r, states=_still(time.size))
    log = log_of(source, p.ctx, 0, 1e-2, 0)
    assert log.u.size < 210 + PAUSE / 1e-2 and log.time[-1] == time[-1]


def test_what_is_unexplained_is_told_in_the_logs_own_time(left_alone):
    """Something unknown holds the machine for a while; its clock began in 1970."""

    def hold(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[0] = 0.6 * np.sin(40.0 * data.qpos[0] ** 2 + 3.0 * data.time)

    config = Config(jobs=1, effects=("viscous_damping",))
    recordings = record(PENDULUM, 0.8, force=hold)
    late = [dataclasses.replace(r, time=1.7e9 + r.time) for r in recordings]
    first, second = (diagnose(mujoco.MjSpec.from_string(PENDULUM), rs, config) for rs in (recordings, late))
    assert first.verdict == second.verdict == "unexplained"
    for a, b in zip(first.unexplained["intervals"], second.unexplained["intervals"], strict=True):
        assert a[0] == b[0]
        np.testing.assert_allclose(np.array(b[1:]) - 1.7e9, a[1:], atol=2e-4)


def test_an_encoder_that_hardly_ever_moves_is_known_by_its_step():
    step = 2 * np.pi / 4096
    value = np.zeros(1000)
    value[200:230] = value[600:601] = step
    assert quantum([value], rests=True) == pytest.approx(step)
    assert quantum([value[190:230]], rests=True) == 0.0
    moved = np.where(np.arange(1000) > 500, 0.7, 0.0)
    assert quantum([moved], rests=True) == quantum([moved, 0.0 * moved, moved], rests=True) == 0.0
    uneven = value + 0.4 * step * (np.arange(1000) > 800)
    assert quantum([uneven], rests=True) == 0.0


def test_a_joint_that_never_moves_has_the_encoder_of_the_others():
    model = mujoco.MjModel.from_xml_string(ARM)
    recordings = record(ARM, [2.0, 0.8])
    for r in recordings:
        r.qpos[:, 0], r.qpos[:, 1] = np.round(r.qpos[:, 0] / 1e-3) * 1e-3, 0.2
    noise, _, _ = estimate(recordings, model, names_of(model))
    assert noise.quantum[1] == noise.quantum[0] == pytest.approx(1e-3)
    assert noise.qpos[1] == pytest.approx(1e-3 / np.sqrt(12))


def test_nobody_knows_how_far_an_angle_went_in_a_gap():
    model = mujoco.MjModel.from_xml_string(SPINNER)
    time = np.concatenate([np.arange(0, 2.52, 0.01), np.arange(5.03, 7, 0.01)])
    q, v = np.sin(5 * time)[:, None], 5 * np.cos(5 * time)[:, None]
    q[:, 0] += 0.1
    last = int(np.argmax(np.diff(time)))
    assert abs(v[last] * (time[last + 1] - time[last])) > 2 * np.pi
    r = unwrapped(Recording("run", time, q, v), model, names_of(model))
    np.testing.assert_array_equal(r.qpos, q)


def test_velocities_carry_an_angle_over_a_few_lost_rows():
    model = mujoco.MjModel.from_xml_string(SPINNER)
    time = np.delete(0.01 * np.arange(100), np.arange(60, 66))
    turned = 5.0 * time
    wrapped = (turned + np.pi) % (2 * np.pi) - np.pi
    assert wrapped[60] < 0 < wrapped[59]
    r = Recording("run", time, wrapped[:, None], np.full((time.size, 1), 5.0))
    np.testing.assert_allclose(unwrapped(r, model, names_of(model)).qpos[:, 0], turned)


def test_filtered_velocities_are_seen_after_a_long_rest():
    time = np.arange(3000) * 1e-3
    q = np.where(time > 1.0, 1.0 - np.cos(6 * (time - 1.0)), 0.0)
    v, filtered = np.gradient(q, time), 0.0
    late = np.empty_like(v)
    for k, x in enumerate(v):
        filtered += (x - filtered) * 1e-3 / 0.02
        late[k] = filtered
    rng = np.random.default_rng(0)
    noisy = q + 1e-5 * rng.standard_normal(q.size)
    for velocity, bad in ((v, []), (late, [0])):
        r = Recording("run", time, noisy[:, None], velocity[:, None])
        assert wrong([r], {0: 0}, np.array([1e-5]), np.array([1e-3])) == bad


@pytest.mark.parametrize(
    ("late", "used"),
    [(0.0, True), (0.004, True), (0.008, False), (-0.008, True)],
    ids=["measured", "half a row", "filtered", "early"],
)
def test_velocities_that_come_late_are_no_velocities(late, used):
    """At 125 Hz, a lag that single rows do not show beside the noise of the positions."""
    rng = np.random.default_rng(0)
    time = np.cumsum(0.008 + 2e-4 * rng.standard_normal(1000))
    q = 0.4 * np.sin(2.0 * time) + 0.15 * np.sin(5.3 * time)
    then = time - late
    v = 0.8 * np.cos(2.0 * then) + 0.795 * np.cos(5.3 * then)
    noisy = q + 2.5e-4 * rng.standard_normal(q.size), v + 5e-3 * rng.standard_normal(q.size)
    r = Recording("run", time, *(x[:, None] for x in noisy))
    model = mujoco.MjModel.from_xml_string(SPINNER)
    noise, warnings = noise_of([r], model, names_of(model))
    assert np.isfinite(noise.qvel[0]) == used
    assert any("disagree with the positions" in x for x in warnings) != used


def test_what_filters_the_velocity_of_one_joint_filters_all():
    """Half a row more than half a row, which at the second joint is next to nothing beside its noise."""
    rng = np.random.default_rng(0)
    time, late = 0.008 * np.arange(1000), 0.008
    q = np.stack([0.4 * np.sin(2.0 * time), 0.15 * np.sin(5.3 * time)], 1)
    v = np.stack([0.8 * np.cos(2.0 * (time - late)), 0.795 * np.cos(5.3 * (time - late))], 1)
    q, v = q + 1e-4 * rng.standard_normal(q.shape), v + np.array([5e-3, 0.03]) * rng.standard_normal(v.shape)
    noise = np.full(2, 1e-4), np.array([2e-3, 0.03])
    assert wrong([Recording("run", time, q, v)], {0: 0, 1: 1}, *noise) == [0, 1]
    assert wrong([Recording("run", time, q[:, 1:], v[:, 1:])], {0: 0}, noise[0][1:], noise[1][1:]) == []


@pytest.mark.parametrize("seconds", [0.9, 1.1])
def test_a_short_recording_holds_shorter_windows(seconds):
    (r,) = record(PENDULUM, 0.8, count=1, seconds=seconds)
    p = prepared_of(PENDULUM, [r])
    for part in PARTS:
        assert p.windows(part, 0.5, 10).count >= 1


def test_transitions_are_joined_in_counting_order(tmp_path):
    model = mujoco.MjModel.from_xml_string(SPINNER)
    for k in range(12):
        q = np.array([[0.1 * k], [0.1 * (k + 1)]])
        np.savez(tmp_path / f"step_{k}.npz", time=[0.0, 0.01], qpos=q, qvel=0 * q, ctrl=np.zeros((2, 0)))
    (joined,) = load_recordings([tmp_path], model, names_of(model))
    np.testing.assert_allclose(joined.qpos[:, 0], 0.1 * np.arange(13))


def test_a_map_of_a_stack_of_tables_is_refused(tmp_path):
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    path = tmp_path / "run.npz"
    np.savez(path, pose=np.zeros((4, 3, 2)))
    with pytest.raises(InputError, match="'pose' has 3 dimensions"):
        apply(path, {}, {"qpos:hinge": "pose"}, model, names_of(model))


def test_a_proposed_experiment_starts_at_rest_for_late_sensors_too():
    class Found:
        prepared = prepared_of(PENDULUM, record(PENDULUM, 0.8))

    q0 = np.array([0.3])
    w = _windows(Found(), q0, np.zeros((2, 20, 1)), 0.002)
    q, v = w.sources[0].state_at(np.array([-0.05, 0.0, 0.02]), 0, 0)
    np.testing.assert_allclose(q, 0.3, atol=1e-12)
    np.testing.assert_array_equal(v, 0.0)
