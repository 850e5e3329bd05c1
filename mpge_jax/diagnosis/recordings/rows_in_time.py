"""Rows in time: columns of one clock at the rows of another, and rows that hold no reading of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.recordings.formats.tables import Table

Array = np.ndarray


@dataclass(frozen=True)
class Clock:
    """How the stamps of commands relate to those of states.

    Attributes:
        ahead: s by which the commands' clock is ahead, to be taken off their stamps.
        notes: what a user should know of it.
    """

    ahead: float = 0.0
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, states: Table, commands: Table) -> Clock:
        """Stamps of two kinds are brought together by what the recorder received: the states' least time under way is
        taken for the difference between the clocks."""
        known = states.time is not None and states.received is not None and states.received.size > 0
        ahead = 0.0
        told = f"commands ({commands.title}) and states ({states.title}) come by ways of their own"
        if known and states.clock != commands.clock:
            sign = 1.0 if commands.clock == "receive stamps" else -1.0
            table = states if sign > 0 else commands
            assert table.time is not None and table.received is not None
            ahead = sign * float(np.min(table.received - table.time))
            told += (
                f", with {commands.clock} and {states.clock}: {ahead:.4g} s were taken off the former, the least that "
                "lay between the two kinds"
            )
        note = (
            f"{told}. Each command is held from the first row of the states after it. A lag that all actuators have in "
            "common is clock or delay, and this log does not tell which."
        )
        return cls(ahead, (note,))


def held(time: Array, sent: Array, value: Array) -> Array:
    """`value` [S], sent at `sent` [S], at the times [T]: the last one sent; NaN before the first."""
    known = np.isfinite(value)
    sent, value = sent[known], value[known]
    at = np.searchsorted(sent, time, side="right") - 1
    if not sent.size:
        return np.full(time.size, np.nan)
    return np.where(at >= 0, value[np.maximum(at, 0)], np.nan)


def interpolated(base: Table, other: Table, value: Array) -> Array:
    """`value` [S] of another table at the rows of `base`, linearly; NaN outside of its times."""
    assert base.time is not None and other.time is not None
    known = np.isfinite(value)
    if known.sum() < 2:
        return np.full(base.rows, np.nan)
    return np.interp(base.time, other.time[known], value[known], left=np.nan, right=np.nan)


def without_empty_rows(name: str, data: dict[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """The arrays without rows that lack what other rows have, repeat a stamp, or repeat a whole reading; and notes.

    A machine that moves does not give the same numbers twice: where the rows on both sides differ, a row that repeats
    the one before it in every number was sent twice and read once.
    """
    time, notes = data["time"], []
    must = [data[k] for k in ("qpos", "qvel", "ctrl") if k in data]
    lacking = np.zeros(time.size, bool)
    for array in must:
        partly = ~np.isnan(array).all(0)
        lacking |= np.isnan(array[:, partly]).any(1)
    keep = ~lacking
    if lacking.any() and keep.any():
        first, last = (int(x) for x in np.flatnonzero(keep)[[0, -1]])
        inside = int(lacking[first:last].sum())
        if first or last < time.size - 1:
            notes.append(
                f"{name}: read from {time[first] - time[0]:.3g} s to {time[last] - time[0]:.3g} s after its first row, "
                "where positions and commands are both there."
            )
        if inside:
            notes.append(f"{name}: {inside} rows between them lack a position or command and are left out.")
    rows = np.flatnonzero(keep)
    again = np.diff(time[rows], prepend=-np.inf) == 0
    if again.any():
        notes.append(
            f"{name}: {int(again.sum())} rows repeat the stamp of the row before them and are left out."
        )
    rows = rows[~again]
    measured = np.concatenate(
        [data[k][rows] for k in ("qpos", "qvel", "actuator_force") if k in data], axis=1
    )
    same = (np.nan_to_num(np.diff(measured, axis=0)) == 0).all(1)
    stale = np.zeros(rows.size, bool)
    stale[2:-1] = same[1:-1] & ~same[:-2] & ~same[2:]
    if stale.any():
        notes.append(
            f"{name}: {int(stale.sum())} rows repeat the reading before them while the machine moves; they were sent "
            "twice and are left out."
        )
    rows = rows[~stale]
    return {k: v[rows] for k, v in data.items()}, notes
