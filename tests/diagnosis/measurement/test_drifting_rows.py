"""Commands whose clock drifts, so that logs have them later by another number of rows at some times than at others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis import Recording
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.measurement.drifting_rows import rows_earlier, with_rows_moved
from mpge_jax.diagnosis.measurement.measurement_model import MeasurementModel
from mpge_jax.diagnosis.recordings.rows.late_rows import READ_SO, commands_moved
from mpge_jax.diagnosis.selection.procedure import Decision
from mpge_jax.diagnosis.selection.remainder import Remainder
from tests.diagnosis.machines import ARM, record
from tests.diagnosis.searches import prepared_of

CHANGE = 200
"""The row from which on commands stand two rows late, not one."""
FIRST, LAST = 3, -3
"""Rows at the ends that hold commands of which none was logged."""
NEAREST = 2


@pytest.fixture(scope="module")
def true() -> list[Recording]:
    return record(ARM, [1.0, 0.6], count=5, seconds=6.0)


def logged(r: Recording) -> Recording:
    """The log of a clock that drifts."""
    rows = np.arange(r.time.size)
    return replace(r, ctrl=r.ctrl[np.maximum(rows - np.where(rows < CHANGE, 1, 2), 0)])


def read(r: Recording, moved: list[tuple[int, int]]) -> Recording:
    """A log of which commands are moved by so many rows from a row on each."""
    by = np.zeros(r.time.size, int)
    for first, rows in moved:
        by[first:] = rows
    return commands_moved(r, by, slice(None))


def told(true: list[Recording], readings: list[list[tuple[int, int]]]):
    return prepared_of(ARM, [read(logged(r), moved) for r, moved in zip(true, readings, strict=True)])


def assert_true(p, true: list[Recording]) -> None:
    """All commands stand at their rows, but for the nearest row or two to where they slip."""
    logs = {r.name: r for r in true}
    for s in p.sources:
        r = logs[s.recording.log]
        sent = r.ctrl[np.searchsorted(r.time, s.recording.time - 1e-9)]
        inside = slice(FIRST, LAST)
        assert np.count_nonzero((s.command != sent)[inside].any(1)) <= NEAREST, s.recording.name
        np.testing.assert_array_equal(s.recording.ctrl, s.command)


RIGHT = [(0, 1), (CHANGE - 1, 2)]


@pytest.mark.parametrize(
    "wrong", [[(0, 1)], [(0, 2)], [(0, 1), (150, 2)], [(0, 2), (160, 3)]], ids=["one", "two", "early", "more"]
)
def test_the_motion_tells_when_rows_slip(true, wrong):
    """Of two logs the rows are told wrongly: by too few or too many, or from another row on."""
    p = told(true, [RIGHT, wrong, RIGHT, RIGHT, wrong])
    by = rows_earlier(p, NOTHING)
    assert by is not None
    assert_true(with_rows_moved(p, by), true)


def test_logs_that_are_read_rightly_stay(true):
    assert rows_earlier(told(true, [RIGHT] * len(true)), NOTHING) is None


def test_what_all_logs_have_in_common_may_be_a_delay(true):
    late = [(0, 0), (CHANGE - 1, 1)]
    assert rows_earlier(told(true, [late] * len(true)), NOTHING) is None


@pytest.mark.parametrize("left", [True, False])
@pytest.mark.parametrize("known", [True, False])
def test_rows_are_told_again_where_some_were_late_and_something_is_left(true, left, known):
    p = told(true, [RIGHT, [(0, 1)], RIGHT, RIGHT, RIGHT])
    p.warnings[:] = [READ_SO] if known else []
    found = Decision(NOTHING, {}, None, Remainder(NOTHING, None, None, None) if left else None, None)
    again = MeasurementModel.without_physics(p, {}).with_moved_rows(found)
    assert (again is not None) == (left and known)
    if again is not None:
        assert_true(again.read(), true)


def test_commands_move_back_as_they_came(true):
    r, by = true[0], np.where(np.arange(true[0].time.size) < CHANGE, 2, 1)
    there = commands_moved(r, by, slice(None))
    back = commands_moved(there, -by, slice(None))
    # where two rows are moved less than those before, one of the log's is passed over
    np.testing.assert_array_equal(back.ctrl[2:CHANGE], r.ctrl[2:CHANGE])
    assert not back.moved.any()
