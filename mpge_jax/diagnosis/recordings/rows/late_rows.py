"""Which command stands in each row of a log: one that was sent rows before, where the motion follows commands before
they were sent, which no delay and no clock of a machine explains. By how many rows may change within a log, where the
clock of the commands drifts."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.recordings.command_lag import (
    ALIKE,
    LEAST,
    SHARP,
    Driven,
    Lag,
    common_lag,
    what_drives,
)
from mpge_jax.diagnosis.recordings.recording import Recording

Array = np.ndarray
MOST = 3
"""Rows by which a command is looked for at most."""
FEWEST_ROWS = 2
"""Rows of the shortest log."""
ROUNDS = 5
READ_SO = (
    "rows of the log hold the command that was sent a row before, or earlier (motion or measured force runs ahead of "
    "the commands): commands were moved back."
)


def without_previous_commands(
    recordings: list[Recording], model: mujoco.MjModel
) -> tuple[list[Recording], list[str]]:
    """The same with every command on the row at which it was given, where each log that tells it has most of its
    commands on later rows. And what was done, for the user."""
    # where some have none, commands drive the machine in all
    measured = all(r.force is not None for r in recordings)
    told = {r.name: k for r in recordings if (k := _rows_before(r, model, measured)) is not None}
    typical = {name: round(float(np.median(k))) for name, k in told.items()}
    if 2 * len(told) <= len(recordings) or not all(typical.values()):
        return recordings, []
    other = round(float(np.median(list(typical.values()))))
    before = {r.name: told.get(r.name, np.full(r.time.size, other)) for r in recordings}
    return [_read_so(r, before[r.name]) for r in recordings], [READ_SO, *_other_than_one(before)]


def commands_moved(r: Recording, by: int | Array, actuators: slice | Array) -> Recording:
    """The same with the commands of some actuators of each row `by` ([T]) rows earlier, the last one repeated; those of
    what came before it as its first ones."""
    if r.ctrl is None:
        return r
    ctrl = r.ctrl.copy()
    ctrl[:, actuators] = r.ctrl[rows_after(r, by)][:, actuators]
    first = int(np.broadcast_to(by, r.time.shape)[0])
    before = None if r.earlier is None else commands_moved(r.earlier, first, actuators)
    return replace(r, ctrl=ctrl, earlier=before, moved=moves_of(r) + by)


def moves_of(r: Recording) -> Array:
    """Rows [T] by which the log had each row's command later."""
    return np.zeros(r.time.size, int) if r.moved is None else r.moved


def rows_after(r: Recording, by: int | Array) -> Array:
    """The row [T] at which that command stands that the log had `by` ([T]) rows later than each row's, or else the
    nearest one."""
    rows, moves = np.arange(r.time.size), moves_of(r)
    logged = np.maximum.accumulate(rows + moves)
    return np.minimum(np.searchsorted(logged, rows + moves + by), rows.size - 1)


def _read_so(r: Recording, before: Array) -> Recording:
    """Every row with the command that stands `before` [T] rows later. The last rows go, as their commands were not
    logged, but from a log of two rows, of which the last tells where the first command led."""
    if r.ctrl is None:
        return r
    at = np.arange(r.time.size) + before
    logged = slice(0, max(int(np.sum(at < r.time.size)), FEWEST_ROWS))
    moved = replace(r, ctrl=r.ctrl[np.minimum(at, r.time.size - 1)], moved=before)
    keys = ("time", "qpos", "qvel", "ctrl", "force", "moved")
    return replace(moved, **{k: v[logged] for k in keys if (v := getattr(moved, k)) is not None})


def _other_than_one(before: dict[str, Array]) -> list[str]:
    """A sentence on logs whose commands moved by other than one row, or by more at some rows than at others."""
    bounds = {name: (int(k.min()), int(k.max())) for name, k in before.items()}
    words = [
        f"{name} by {least if least == most else f'{least} to {most}'}"
        for name, (least, most) in bounds.items()
        if (least, most) != (1, 1)
    ]
    return [f"commands moved by other than one row: {', '.join(words)}."] if words else []


def _rows_before(r: Recording, model: mujoco.MjModel, measured: bool) -> Array | None:
    """For each row how many rows before it the command was given that stands in it [T]; None where nothing tells."""
    if r.ctrl is None:
        return None
    driven = what_drives(r.time, r.qpos, r.qvel, r.ctrl, model, r.force if measured else None)
    lag = common_lag(driven, r.ctrl)
    if driven is None or lag is None:
        return None
    if not 0.5 * lag.step < -lag.common < (MOST + 0.5) * lag.step:
        return np.zeros(r.time.size, int)
    k = _Shifts(driven, r, lag).likeliest()
    return k[np.searchsorted(driven.rows, np.arange(r.time.size)).clip(max=k.size - 1)]


class _Shifts:
    """A log's commands, moved by some rows, beside the forces of its joints; of actuators that act later than the
    others no more is known than that they do."""

    def __init__(self, driven: Driven, r: Recording, lag: Lag) -> None:
        self.driven, self.at = driven, np.arange(driven.rows.size)
        rows, ctrl = np.arange(r.time.size), r.ctrl
        assert ctrl is not None
        self.means, self.late = {}, {}
        for a in (a for a, own in lag.each.items() if own - lag.common <= ALIKE * lag.step):
            moved = (ctrl[np.minimum(rows + k, rows.size - 1), a] for k in range(MOST + 1))
            self.means[a] = np.array([driven.mean(command) for command in moved])
            self.late[a] = driven.mean(ctrl[:, a], lag.common)

    def likeliest(self) -> Array:
        """Rows [R] by which commands moved, by turns with what a command does, from that of the mean lag on."""
        k = least_changing(self._costs(self.late))
        for _ in range(ROUNDS):
            new = least_changing(self._costs({a: x[k, self.at] for a, x in self.means.items()}))
            if np.array_equal(new, k):
                break
            k = new
        return k

    def _costs(self, commands: dict[int, Array]) -> Array:
        """Twice the log likelihood [MOST + 1, R] that each shift lacks at each row, by the law that `commands` [R]
        show."""
        costs = np.zeros((MOST + 1, self.at.size))
        for a, now in commands.items():
            left = self.driven.left(a, now)
            size = max(float(np.mean(left**2)), LEAST * float(np.mean(now**2)))
            costs += (left + self.means[a] - now) ** 2 / size
        return costs / (2 * self.driven.s)


def least_changing(cost: Array, change: float = SHARP) -> Array:
    """The state at each row for which the sum of `cost` [states, R], and of what changes cost, is least (Viterbi)."""
    total, came = cost[:, 0].copy(), np.empty(cost.shape, int)
    for t in range(1, cost.shape[1]):
        best = int(total.argmin())
        changes = total[best] + change < total
        came[:, t] = np.where(changes, best, np.arange(total.size))
        total = np.where(changes, total[best] + change, total) + cost[:, t]
    states = np.empty(cost.shape[1], int)
    states[-1] = int(total.argmin())
    for t in range(cost.shape[1] - 1, 0, -1):
        states[t - 1] = came[states[t], t]
    return states
