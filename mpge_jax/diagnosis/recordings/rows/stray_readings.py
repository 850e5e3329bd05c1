"""Readings that no motion gives: a position that is somewhere else for a single row."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.noise_level import MAD, quantum
from mpge_jax.diagnosis.recordings.recording import Recording, quaternion_columns

Array = np.ndarray
REACH = 2
"""Rows on either side that tell where a reading should be: a cubic through four of them."""
FAR = 16.0
"""Deviations of other readings, here and in all of a recording, from which on a reading is doubted."""
ALONE = 0.1
"""Share of the misses of the five cubics around a stray reading that it may leave; a kink of a motion, as an impact
makes it, leaves 0.22."""
NEAR = 20
"""Rows on either side whose misses are compared."""
MOST = 0.02
"""Share of a column's readings from which on they are not strays but how it is measured."""
STEPS = 3.0
"""Part of an encoder's step that counts as a usual miss at least."""
FEWEST_ROWS = 12


def without_stray_readings(r: Recording, model: mujoco.MjModel, names: Names) -> Recording:
    """The recording with stray positions replaced by what their neighbours say, and a warning."""
    turning = {c for first, end in quaternion_columns(model) for c in range(first, end)}
    qpos, found = r.qpos.copy(), []
    for column in (c for c in range(model.nq) if c not in turning):
        stray = stray_rows(r.time, qpos[:, column])
        if stray.any():
            good = ~stray
            qpos[stray, column] = np.interp(r.time[stray], r.time[good], qpos[good, column])
            refined = _expected(r.time, qpos[:, column])
            qpos[stray, column] = np.where(np.isfinite(refined), refined, qpos[:, column])[stray]
            joint = names.joints[int(np.flatnonzero(model.jnt_qposadr <= column)[-1])]
            found.append(f"{int(stray.sum())} of joint {joint}")
    if not found:
        return r
    note = (
        f"{r.name}: positions that jump away and back within a row, which no motion does, are taken from their "
        f"neighbours: {', '.join(found)} (of {r.time.size} rows)."
    )
    return replace(r, qpos=qpos, warnings=(*r.warnings, note))


def stray_rows(time: Array, value: Array) -> Array:
    """Which readings [T] of a column are somewhere else for a single row; none where that is common.

    What a reading misses by, of the cubic through its four neighbours, is compared with what others miss, each in units
    of what noise makes of it where rows are unevenly spaced. A stray reading moves the cubics of its neighbours too, in
    proportions that follow from the times: where these explain the five misses, better than those of any reading near
    it, and it lies beyond both its neighbours, it is one. (A reading between them may be older than its stamp.)
    """
    stray = np.zeros(value.size, bool)
    if value.size < FEWEST_ROWS or not np.isfinite(value).all():
        return stray
    value, step = value.copy(), quantum([value], rests=True)
    weights = _weights(time)
    noise = np.maximum(np.linalg.norm(weights, axis=1), 1e-300)
    pattern = _patterns(weights / noise[:, None])
    for _ in range(int(MOST * value.size) + 1):
        missed = _missed(weights, value)
        size = np.abs(missed) / noise
        usual = np.maximum(_around(size), MAD * np.median(size[REACH:-REACH]))
        usual = np.maximum(usual, max(step / STEPS, np.spacing(np.abs(value).max(initial=1.0))))
        around = _near(missed / noise)
        explained = np.einsum("tk,tk->t", pattern, around)
        left = np.linalg.norm(around - explained[:, None] * pattern, axis=1)
        alone = left < ALONE * np.linalg.norm(around, axis=1)
        far = _beyond_neighbours(value) > FAR * usual
        doubt = np.abs(explained) / usual
        found = np.flatnonzero((doubt >= _near(doubt).max(1)) & far & alone & ~stray)
        if not found.size:
            break
        stray[found] = True
        value[found] -= missed[found]
    return stray if stray.mean() <= MOST else np.zeros(value.size, bool)


def _weights(time: Array) -> Array:
    """[T, 5] what a reading misses by, as weights of it and its neighbours; zero at the ends."""
    offsets = np.array([-2, -1, 1, 2])
    rows = np.arange(REACH, time.size - REACH)
    t = time[rows[:, None] + offsets] - time[rows, None]
    gaps = t[:, None, :] - t[:, :, None]  # of each neighbour to each other one
    np.einsum("rii->ri", gaps)[:] = 1.0
    towards = np.repeat(t[:, None, :], 4, axis=1)
    np.einsum("rii->ri", towards)[:] = 1.0
    lagrange = (towards / gaps).prod(-1)
    out = np.zeros((time.size, 5))
    out[REACH:-REACH, 2] = 1.0
    out[REACH:-REACH, [0, 1, 3, 4]] = -lagrange
    return out


def _missed(weights: Array, value: Array) -> Array:
    """[T] what each reading misses by; 0 at the ends."""
    missed: Array = np.einsum("tk,tk->t", weights, _near(value))
    return missed


def _expected(time: Array, value: Array) -> Array:
    """Where the neighbours put each reading [T]; NaN at the ends."""
    out = value - _missed(_weights(time), value)
    out[:REACH] = out[-REACH:] = np.nan
    return out


def _around(size: Array) -> Array:
    """Median [T] over the rows around each, those that it moves itself left out."""
    offsets = np.concatenate([np.arange(-NEAR, -REACH), np.arange(REACH + 1, NEAR + 1)])
    rows = np.clip(np.arange(size.size)[:, None] + offsets, REACH, size.size - REACH - 1)
    return MAD * np.median(size[rows], axis=1)


def _beyond_neighbours(value: Array) -> Array:
    """How far [T] each reading lies outside of what is between the one before and the one after; 0 at the ends."""
    out = np.zeros(value.size)
    before, here, after = value[:-2], value[1:-1], value[2:]
    out[1:-1] = np.maximum(here - np.maximum(before, after), np.minimum(before, after) - here)
    return out


def _near(x: Array) -> Array:
    """[T, 5] of each row and its neighbours; zero beyond the ends."""
    padded = np.pad(x, REACH)
    return np.stack([padded[k : k + x.size] for k in range(2 * REACH + 1)], axis=1)


def _patterns(weights: Array) -> Array:
    """[T, 5] in what proportions a wrong reading in each row moves the misses around it; of length one."""
    last = 2 * REACH
    out = np.stack([_near(weights[:, last - k])[:, k] for k in range(last + 1)], axis=1)
    length: Array = np.linalg.norm(out, axis=1, keepdims=True)
    return out / np.maximum(length, 1e-300)
