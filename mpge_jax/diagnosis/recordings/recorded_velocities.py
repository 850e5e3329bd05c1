"""Whether recorded velocities are measurements: independent of the recorded positions, and of the same motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.recordings.kalman_smoother import Series, smooth
from mpge_jax.diagnosis.recordings.noise_level import MIN_ROWS
from mpge_jax.diagnosis.recordings.recording import Recording

Array = np.ndarray
LOOKED_AT = 400
"""Rows of a recording that are smoothed to compare velocities with."""
RESTING = 0.1
"""Share of its way at its liveliest below which a joint rests."""
SPAN, FEWEST_SPANS = 0.05, 30
"""Seconds over which velocities are added up to compare them with the way that was gone, and how many such spans it
takes."""
SURE = 4.0
"""Standard deviations from which on velocities are late for sure."""
NEXT_TO_NOTHING = 0.5
"""Share of the noise of velocities up to which what a lag makes of them is no reason to leave them out."""
EQUAL, EXACT = 1e-3, 3e-3
"""Velocities within this share of the positions' slope, there or its rms, are computed from it; those whose noise is a
smaller share of their spread are exact, wherever they come from."""


def wrong(
    recordings: list[Recording],
    dofs: dict[int, int],
    qpos_noise: Array,
    qvel_noise: Array,
) -> list[int]:
    """Degrees of freedom whose recorded velocity is not the derivative of the recorded position."""
    bad = _late(recordings, dofs, qvel_noise)
    for column, dof in dofs.items():
        if dof in bad or not np.isfinite(qvel_noise[dof]):
            continue
        usable = [
            r
            for r in recordings
            if r.qvel is not None
            and r.time.size >= 60
            and not np.isnan(r.qpos[:, column]).all()
            and not np.isnan(r.qvel[:, dof]).all()
        ][:4]
        if not usable:
            continue
        rows = [_liveliest(r.qpos[:, column]) for r in usable]
        estimates = smooth(
            [
                Series(r.time[k], r.qpos[k, column], None, np.full(r.time[k].size, qpos_noise[column]), 1.0)
                for r, k in zip(usable, rows, strict=True)
            ]
        )
        ratio = []
        for r, k, s in zip(usable, rows, estimates, strict=True):
            inner = slice(10, s.mean.shape[0] - 10)
            velocity = r.known("qvel")[k, dof]
            error = velocity[inner] - s.mean[inner, 1]
            expected = s.cov[inner, 1, 1] + qvel_noise[dof] ** 2
            tolerance = (0.02 * np.std(velocity)) ** 2
            ratio.append(float(np.median(error**2 / (expected + tolerance))))
        if np.median(ratio) > 4.0:
            bad.append(dof)
    return bad


@dataclass(frozen=True)
class _Lag:
    """By how much (s) velocities come later than the positions.

    Attributes:
        deviation: of that. row: time between rows. acceleration: rms.
    """

    lag: float
    deviation: float
    row: float
    acceleration: float

    def beyond(self, allowed: float, noise: float) -> bool:
        """Whether it is more than a lag (s) for sure, and velocities miss more by it than is next to nothing."""
        more = self.lag - allowed
        return more > SURE * self.deviation and more * self.acceleration > NEXT_TO_NOTHING * noise


def _late(recordings: list[Recording], dofs: dict[int, int], qvel_noise: Array) -> list[int]:
    """Degrees of freedom whose velocities come later than their positions, as filtered ones do.

    Half a row's time is no lag by itself: velocities may change at once where a row begins, and semi-implicit steps
    leave them half a step behind. But what filters some filters all.
    """
    lags = {
        dof: _lag(recordings, column, dof) for column, dof in dofs.items() if np.isfinite(qvel_noise[dof])
    }
    known = {dof: x for dof, x in lags.items() if x is not None}
    if not any(x.beyond(0.5 * x.row, qvel_noise[dof]) for dof, x in known.items()):
        return []
    return [dof for dof, x in known.items() if x.beyond(0.0, qvel_noise[dof])]


def _lag(recordings: list[Recording], column: int, dof: int) -> _Lag | None:
    """What velocities miss of the way over a span is their lag times the change of velocity; None where there are too
    few rows to tell."""
    missed, changed, accelerations, row = [], [], [], []
    for r in recordings:
        if r.qvel is None:
            continue
        known = np.isfinite(r.qpos[:, column]) & np.isfinite(r.qvel[:, dof])
        t, q, v = r.time[known], r.qpos[known, column], r.qvel[known, dof]
        if t.size < MIN_ROWS:
            continue
        step = np.diff(t)
        row.append(float(np.median(step)))
        way = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * step)])
        ends = np.arange(0, t.size, max(2, round(SPAN / row[-1])))
        whole = np.maximum.reduceat(step, ends[:-1]) < 2.0 * row[-1]
        missed.append(np.diff((q - way)[ends])[whole])
        changed.append(np.diff(v[ends])[whole])
        accelerations.append(np.gradient(v, t))
    if sum(map(len, missed)) < FEWEST_SPANS:
        return None
    x, y = np.concatenate(changed), np.concatenate(missed)
    square = float(x @ x) + 1e-300
    lag = float(x @ y) / square
    deviation = float(np.linalg.norm(x * (y - lag * x))) / square
    return _Lag(
        lag, deviation, float(np.median(row)), float(np.sqrt(np.mean(np.concatenate(accelerations) ** 2)))
    )


def _liveliest(value: Array) -> slice:
    """The first `LOOKED_AT` rows, or where next to nothing moves in these, those in which a position changes most."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(value)))])
    if value.size <= LOOKED_AT:
        return slice(0, value.size)
    moved = way[LOOKED_AT - 1 :] - way[: 1 - LOOKED_AT]
    first = int(np.argmax(moved)) if moved[0] < RESTING * moved.max() else 0
    return slice(first, first + LOOKED_AT)


def derived(recordings: list[Recording], dofs: dict[int, int], qvel_noise: Array) -> list[int]:
    """Degrees of freedom whose noisy velocities somebody computed from the positions of neighbouring rows."""
    found = []
    for column, dof in dofs.items():
        equal, noisy = [], []
        for r in recordings:
            if r.qvel is None or np.isnan(r.qpos[:, column]).any() or np.isnan(r.qvel[:, dof]).any():
                continue
            q, t, v = r.qpos[:, column], r.time, r.qvel[:, dof]
            ahead, about = np.diff(q) / np.diff(t), (q[2:] - q[:-2]) / (t[2:] - t[:-2])
            guesses = ((v[1:], ahead), (v[:-1], ahead), (v[1:-1], about), (v, np.gradient(q, t)))
            if (np.abs(ahead) > 0).sum() < MIN_ROWS:
                continue
            equal.append(max(_equal(x, y) for x, y in guesses))
            noisy.append(qvel_noise[dof] > EXACT * v.std())
        # velocities of an engine that steps semi-implicitly are differences as well, but exact
        if equal and min(equal) > 0.9 and np.median(noisy) > 0.5:
            found.append(dof)
    return found


def _equal(velocity: Array, slope: Array) -> float:
    """Share of the rows, of those that move, in which a velocity is a slope, but for the digits that were written."""
    moves = slope != 0
    size = np.maximum(np.abs(slope), np.sqrt(np.mean(slope**2)))
    return float(np.mean(np.abs(velocity - slope)[moves] < EQUAL * size[moves]))
