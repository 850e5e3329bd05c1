"""Which command stands in each row of a log, where the clock of the commands drifts."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Recording
from mpge_jax.diagnosis.recordings.command_lag import SHARP
from mpge_jax.diagnosis.recordings.rows.late_rows import READ_SO, least_changing, without_previous_commands
from tests.diagnosis.machines import ARM, record

MODEL = mujoco.MjModel.from_xml_string(ARM)


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    """An arm whose joints rub, seen with slight noise."""

    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[:] = 0.05

    return record(ARM, [1.5, 0.6], change=change, seconds=4.0, noise=1e-5)


def logged(r: Recording, before: np.ndarray) -> Recording:
    """A log whose rows hold the command of so many rows before."""
    return replace(r, ctrl=r.ctrl[np.maximum(np.arange(r.time.size) - before, 0)])


def drifting(r: Recording, first: int, at: int) -> np.ndarray:
    return np.where(np.arange(r.time.size) < at, first, first + 1)


def wrong_rows(read: Recording, true: Recording) -> np.ndarray:
    return np.flatnonzero((read.ctrl != true.ctrl[: read.time.size]).any(axis=1))


def test_a_clock_that_drifts_moves_commands_by_one_row_and_later_by_two(runs):
    logs = [logged(r, drifting(r, 1, 230 + 20 * k)) for k, r in enumerate(runs)]
    read, told = without_previous_commands(logs, MODEL)
    for k, (r, true) in enumerate(zip(read, runs, strict=True)):
        # the last two rows' commands were not logged
        assert r.time.size == true.time.size - 2
        np.testing.assert_array_equal(r.qpos, true.qpos[:-2])
        # a change is told to within the rows that accelerations are taken over
        assert np.all(np.abs(wrong_rows(r, true) - (230 + 20 * k)) <= 6)
    assert told[0] == READ_SO
    assert told[1] == (
        "commands moved by other than one row: run_0 by 1 to 2, run_1 by 1 to 2, run_2 by 1 to 2, run_3 by 1 to 2."
    )


@pytest.mark.parametrize("before", [1, 2, 3])
def test_the_same_throughout(runs, before):
    read, told = without_previous_commands([logged(r, np.full(r.time.size, before)) for r in runs], MODEL)
    assert len(told) == (1 if before == 1 else 2)
    for r, true in zip(read, runs, strict=True):
        assert r.time.size == true.time.size - before and wrong_rows(r, true).size == 0


def test_commands_in_their_rows_stay(runs):
    assert without_previous_commands(runs, MODEL) == (runs, [])
    # nor where some are: no log of a machine is read in two ways
    some = [logged(r, np.full(r.time.size, int(k > 0))) for k, r in enumerate(runs)]
    assert without_previous_commands(some, MODEL) == (some, [])


@pytest.mark.parametrize("own", [2, 4])
def test_what_one_actuator_is_late_by_is_its_own(runs, own):
    """A motor that acts rows late beside one that does not: of when the clock changed it tells nothing."""
    late = [replace(r, ctrl=r.ctrl.copy()) for r in runs]
    for r in late:
        r.ctrl[:-own, 1] = r.ctrl[own:, 1].copy()
    read, told = without_previous_commands([logged(r, drifting(r, 2, 250)) for r in late], MODEL)
    assert told[0] == READ_SO
    for r, given in zip(read, late, strict=True):
        assert wrong_rows(r, given).size <= 3


def test_an_actuator_that_is_late_and_seen_clearly_outvotes_none(runs):
    late, rng = [], np.random.default_rng(0)
    for r in runs:
        noise = 3e-5 * rng.standard_normal(r.time.size)
        r = replace(r, ctrl=r.ctrl.copy(), qpos=r.qpos + np.stack([noise, 0 * noise], axis=1))
        r.ctrl[:-2, 1] = r.ctrl[2:, 1].copy()
        late.append(r)
    read, _ = without_previous_commands([logged(r, np.full(r.time.size, 2)) for r in late], MODEL)
    assert all(wrong_rows(r, given).size == 0 for r, given in zip(read, late, strict=True))


def test_a_log_that_tells_nothing_is_read_as_the_others(runs):
    stub = replace(runs[0], **{k: getattr(runs[0], k)[10:40] for k in ("time", "qpos", "ctrl")}, name="stub")
    read, _ = without_previous_commands([logged(r, np.full(r.time.size, 2)) for r in (*runs, stub)], MODEL)
    np.testing.assert_array_equal(read[-1].ctrl, stub.ctrl[:-2])


def test_a_change_must_be_worth_its_cost():
    cost = np.zeros((2, 6))
    cost[1, :3] = SHARP
    cost[0, 3:] = 0.4 * SHARP
    # staying at 0 costs 1.2 SHARP, one change SHARP
    assert least_changing(cost).tolist() == [0, 0, 0, 1, 1, 1]
    cost[0, 3:] = 0.3 * SHARP
    assert least_changing(cost).tolist() == [0] * 6
