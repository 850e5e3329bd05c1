"""Rows in time: columns of one clock at the rows of another, and rows that hold no reading of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.recordings.formats.tables import Table

Array = np.ndarray


@dataclass(frozen=True)
class Clock:
    """How the stamps of a table relate to those of the states: s by which its clock is ahead, and that in words."""

    ahead: float
    told: str

    @classmethod
    def of(cls, states: Table, other: Table) -> Clock:
        """Stamps of two kinds are brought together by what the recorder received: the least time between a header's
        stamp and its arrival is taken for the difference between the clocks."""
        told = f"{other.title} comes apart from {states.title}"
        if states.received is None or states.clock == other.clock:
            return cls(0.0, told)
        sign = 1.0 if other.clock == "receive stamps" else -1.0
        stamped = states if sign > 0 else other
        assert stamped.time is not None and stamped.received is not None
        ahead = sign * float(np.min(stamped.received - stamped.time))
        between = (
            f"by {other.clock} beside {states.clock}, between which lay {1e3 * abs(ahead):.4g} ms at least"
        )
        return cls(ahead, f"{told}, {between}: taken off")


def middles(time: Array) -> Array:
    """[T] s half-way from each row to the next, which tells best what was sent for the time between them."""
    steps = np.diff(time)
    return time + 0.5 * np.append(steps, np.median(steps) if steps.size else 0.0)


def held(time: Array, sent: Array, value: Array) -> Array:
    """`value` [S], sent at `sent` [S], at the times [T]: the last one sent; NaN before the first."""
    known = np.isfinite(value)
    sent, value = sent[known], value[known]
    at = np.searchsorted(sent, time, side="right") - 1
    if not sent.size:
        return np.full(time.size, np.nan)
    return np.where(at >= 0, value[np.maximum(at, 0)], np.nan)


def interpolated(time: Array, measured: Array, value: Array) -> Array:
    """`value` [S], measured at `measured` [S], at the times [T], linearly; NaN outside of them."""
    known = np.isfinite(value)
    if known.sum() < 2:
        return np.full(time.size, np.nan)
    return np.interp(time, measured[known], value[known], left=np.nan, right=np.nan)


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
