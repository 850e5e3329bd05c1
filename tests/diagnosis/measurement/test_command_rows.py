"""Logs whose rows hold the command of the row before."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Recording
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.measurement.command_rows import rows_are_late, with_earlier_commands
from mpge_jax.diagnosis.measurement.measurement_model import MeasurementModel
from mpge_jax.diagnosis.recordings.rows.late_rows import READ_SO, without_previous_commands
from mpge_jax.diagnosis.selection.procedure import Decision
from mpge_jax.diagnosis.selection.setup import build_search
from tests.diagnosis.machines import ARM, ROTORS, record
from tests.diagnosis.searches import fitted, prepared_of

DRAG = Term("viscous_damping", Place("joint", "x", 0))


def moved(recordings: list[Recording], rows: int) -> list[Recording]:
    """Logs with every command `rows` later than it was given."""
    at = [np.clip(np.arange(r.time.size) - rows, 0, r.time.size - 1) for r in recordings]
    return [replace(r, ctrl=r.ctrl[k]) for r, k in zip(recordings, at, strict=True)]


@pytest.fixture(scope="module")
def flights() -> list[Recording]:
    """A drone with drag, whose thrust turns it: no joint has a motor, so that no force of one tells its command's."""

    def change(model: mujoco.MjModel) -> None:
        model.dof_damping[0] = 0.5

    return record(ROTORS, [3.0, 3.0], change=change)


@pytest.mark.parametrize(("rows", "late"), [(2, True), (1, True), (0, False), (-1, False)])
def test_the_likelihood_tells_which_row_a_command_belongs_to(flights, rows, late):
    logs = moved(flights, rows)
    assert not without_previous_commands(logs, mujoco.MjModel.from_xml_string(ROTORS))[1]
    p = prepared_of(ROTORS, logs)
    s = build_search(p, lambda _text: None, p.config.decide_s)
    # told from elsewhere, it is fitted anew either way
    f = fitted(s, {DRAG: [1.5]})
    assert rows_are_late(p, f) == late
    again = MeasurementModel.without_physics(p, {}).with_moved_rows(Decision(f, {}, None, None, None))
    assert (again is not None) == late == (READ_SO in p.warnings)
    if late:
        true = {r.name: r.ctrl for r in flights}
        for x in again.read().train:
            rows_of = np.searchsorted(flights[0].time, x.recording.time[:-rows] - 1e-9)
            np.testing.assert_array_equal(x.command[:-rows], true[x.recording.log][rows_of])


def test_where_nothing_is_missing_nobody_asks(flights):
    p = prepared_of(ROTORS, moved(flights, 1))
    measurement = MeasurementModel.without_physics(p, {})
    assert measurement.with_moved_rows(Decision(NOTHING, {}, None, None, None)) is None


def test_measured_forces_stay_on_their_rows(flights):
    p = prepared_of(ROTORS, flights)
    p = replace(p, measured=np.array([True, False]))
    for old, new in zip(p.train, with_earlier_commands(p).train, strict=True):
        np.testing.assert_array_equal(new.command[:, 0], old.command[:, 0])
        np.testing.assert_array_equal(new.command[:-1, 1], old.command[1:, 1])


SWIMMER = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body name="trunk"><freejoint/>
<geom type="box" size=".1 .1 .1" mass="1"/><body name="fin" pos=".1 0 0">
<joint name="hinge" axis="0 1 0" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".3"/></body></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
"""A free body, on which inverse dynamics tells nothing of commands here."""


@pytest.mark.parametrize("velocities", [True, False])
@pytest.mark.parametrize("holes", [None, "a row", "a recording"])
def test_measured_forces_tell_it_before_any_search(velocities, holes):
    model, rng = mujoco.MjModel.from_xml_string(SWIMMER), np.random.default_rng(0)
    runs = []
    for k in range(3):
        data, rows = mujoco.MjData(model), []
        for i in range(200):
            u = 0.3 * np.sin(0.3 * i + k) + 0.2 * np.sign(np.sin(0.11 * i))
            rows.append((0.02 * i, data.qpos.copy(), data.qvel.copy(), [u]))
            data.ctrl[:] = u
            mujoco.mj_step(model, data, 10)
        time, q, v, ctrl = (np.array(x) for x in zip(*rows, strict=True))
        force = ctrl + 1e-3 * rng.standard_normal(ctrl.shape)
        if holes == "a row":
            force[50] = np.nan
        runs.append(Recording(f"run_{k}", time, q, v if velocities else None, ctrl, force))
    if holes == "a recording":
        runs[1] = replace(runs[1], force=None)
    for late in (True, False):
        read, told = without_previous_commands(moved(runs, int(late)), model)
        assert told == ([READ_SO] if late and holes is None else [])
        if told:
            for r, true in zip(read, runs, strict=True):
                # the last row's command was not logged
                assert r.time.size == r.force.shape[0] == true.time.size - 1
                np.testing.assert_array_equal(r.ctrl, true.ctrl[:-1])
                np.testing.assert_array_equal(r.force, true.force[:-1])


def test_a_log_of_two_rows_keeps_both():
    runs = record(ARM, [1.5, 0.6], rate=50)
    stub = replace(runs[0], **{k: getattr(runs[0], k)[10:12] for k in ("time", "qpos", "ctrl")}, name="stub")
    read, told = without_previous_commands(moved([*runs, stub], 1), mujoco.MjModel.from_xml_string(ARM))
    assert told == [READ_SO] and [r.time.size for r in read] == [*(r.time.size - 1 for r in runs), 2]


def test_commands_are_moved_once(flights):
    p = prepared_of(ROTORS, moved(flights, 2))
    p.warnings.append(READ_SO)
    s = build_search(p, lambda _text: None, p.config.decide_s)
    found = Decision(fitted(s, {DRAG: [0.5]}), {}, None, None, None)
    assert MeasurementModel.without_physics(p, {}).with_moved_rows(found) is None


@pytest.mark.parametrize(("rows", "late"), [(1, True), (0, False)])
def test_the_moment_of_commands_is_not_seen_past_where_it_is_asked_for(rows, late):
    """Noise of 1 mrad: the rows' ages would hide behind what searches allow commands to be late by."""
    logs = moved(record(ARM, [1.0, 0.6], noise=1e-3, count=6), rows)
    assert not without_previous_commands(logs, mujoco.MjModel.from_xml_string(ARM))[1]
    assert rows_are_late(prepared_of(ARM, logs), NOTHING) == late
