"""By how many rows commands stand late where their clock drifts, told by the simulated motion: what forces tell of it
before any physics is known is a row, or the moment of a change, off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mpge_jax.diagnosis.dataset.cut_windows import cut
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss
from mpge_jax.diagnosis.measurement.command_rows import (
    fitted_anew,
    that_sees_when,
    windows_of,
    with_commands_moved,
)
from mpge_jax.diagnosis.recordings.rows.late_rows import least_changing, moves_of
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import Windows
from mpge_jax.diagnosis.thresholds import SURE

Array = np.ndarray
MOVES = (-2, -1, 0, 1, 2)
"""Rows by which commands are tried earlier than they are read."""
WINDOWS, MOMENTS = 600, 12
"""Windows at most; moments at which a change between two of them is tried at first, before the rows around the best."""


@dataclass(frozen=True)
class _Rows:
    """By how many rows a log has the commands later: `moves` [n + 1] before, between and after `slips` [n] (s)."""

    moves: Array
    slips: Array

    def at(self, time: Array) -> Array:
        """At some times [T]."""
        out: Array = self.moves[np.searchsorted(self.slips, time + 1e-9)]
        return out

    def slipping(self, n: int, moment: float) -> _Rows:
        """The same with slip `n` at another moment."""
        return replace(self, slips=np.where(np.arange(self.slips.size) == n, moment, self.slips))


def rows_earlier(p: Prepared, f: Fitted) -> list[Array] | None:
    """By how many rows [T] the commands of each recording were given earlier than they are read, the parameters of `f`
    fitted anew; None where all are to move alike, if at all: no log tells that from a delay."""
    if p.measured.all():
        return None
    f = fitted_anew(p, f, windows_of(p, "train"))
    rng = np.random.default_rng([p.config.seed, 37])
    w = cut(p.sources, p.model, p.noise, p.config.decide_s, WINDOWS, p.dt, rng)
    white = that_sees_when(p, f, w)
    losses = np.array([_losses(p, f, w, white, with_rows_moved(p, [k] * len(p.sources))) for k in MOVES])
    logs = np.array([s.recording.log for s in p.sources])
    by = [np.zeros(s.recording.time.size, int) for s in p.sources]
    for log in dict.fromkeys(logs[w.source].tolist()):
        its = np.flatnonzero(logs[w.source] == log)
        its = its[np.argsort(w.start[its])]
        read = np.array([_in_the_middle(w, int(k)) for k in its])
        moves, gained = _likeliest(losses[:, its], read)
        if gained > 2.0 * SURE:
            rows = _slipping(p, f, w.take(its), white.take(its), moves)
            by = [_from(s, rows) if s.recording.log == log else x for s, x in zip(p.sources, by, strict=True)]
    return by if np.ptp(np.concatenate(by)) else None


def _in_the_middle(w: Windows, k: int) -> int:
    """By how many rows the log had the commands in the middle of a window later than they are read."""
    r = w.sources[w.source[k]].recording
    return int(moves_of(r)[np.searchsorted(r.time, w.start[k] + 0.5 * w.times[k].max())])


def _from(s: Source, rows: _Rows) -> Array:
    """By how many rows [T] commands move from where they are read."""
    return rows.at(s.recording.time) - moves_of(s.recording)


def with_rows_moved(p: Prepared, by: Sequence[int | Array]) -> Prepared:
    """The same with the commands of each recording so many rows earlier."""
    of = {id(s): k for s, k in zip(p.sources, by, strict=True)}
    return p.mapped(lambda s: with_commands_moved(s, of[id(s)], p.measured))


def _likeliest(losses: Array, read: Array) -> tuple[Array, float]:
    """By how many rows the log had the commands of each window later, and what that gains.

    Args:
        losses: [moves, W] by `MOVES`. read: [W] rows by which it is taken to have them later.
    """
    every = np.arange(read.min() + MOVES[0], read.max() + MOVES[-1] + 1)
    cost = np.full((every.size, read.size), np.inf)
    for move, loss in zip(MOVES, losses, strict=True):
        cost[read + move - every[0], np.arange(read.size)] = loss
    states = least_changing(cost, 2.0 * SURE)

    def total(rows: Array) -> float:
        found = cost[rows - every[0], np.arange(read.size)].sum()
        return float(found + 2.0 * SURE * np.count_nonzero(np.diff(rows)))

    return every[states], total(read) - total(every[states])


def _slipping(p: Prepared, f: Fitted, w: Windows, white: Whitener, moves: Array) -> _Rows:
    """The rows by which a log has the commands later, as its windows tell (`moves` [W]): each slip is where the two
    windows between which it lies are predicted best."""
    log = w.sources[w.source[0]].recording.log
    between = np.flatnonzero(np.diff(moves))
    rows = _Rows(moves[np.append(between, -1)], w.start[between + 1])
    for n, k in enumerate(between):
        pair = np.array([k, k + 1])
        time = w.sources[w.source[k]].recording.time
        times = time[slice(*np.searchsorted(time, [w.start[k], w.start[k + 1] + w.times[k + 1].max()]))]

        def left(row: int, n: int = n, at: Array = pair, times: Array = times, rows: _Rows = rows) -> float:
            its = [_from(s, rows.slipping(n, times[row])) if s.recording.log == log else 0 for s in p.sources]
            return float(_losses(p, f, w.take(at), white.take(at), with_rows_moved(p, its)).sum())

        step = max(times.size // MOMENTS, 1)
        near = min(range(0, times.size, step), key=left)
        row = min(range(max(near - step, 0), min(near + step + 1, times.size)), key=left)
        rows = rows.slipping(n, times[row])
    return rows


def _losses(p: Prepared, f: Fitted, w: Windows, white: Whitener, moved: Prepared) -> Array:
    """Losses [W] of windows under the commands of `moved`."""
    left = p.sim.residuals([Run(f.hypothesis, f.theta)], w.driven_by(moved.sources))[0]
    return robust_loss(white.excess(white(left)))
