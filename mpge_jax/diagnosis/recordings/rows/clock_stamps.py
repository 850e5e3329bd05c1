"""Readings at hiccups of the clock: a row whose loop was held up carries a late stamp, but perhaps an early reading."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import Names, is_scalar
from mpge_jax.diagnosis.recordings.noise_level import MIN_ROWS, noise_level
from mpge_jax.diagnosis.recordings.recording import Recording

Array = np.ndarray
HICCUP, GAP = 1.4, 5.0
"""A step of the clock longer than so many median steps is a hiccup, one longer than so many a gap in the log."""
NEIGHBOURS = 4
"""Rows on each side of a hiccup that say where the joint was."""
WRONG, RIGHT = 5.0, 0.4
"""Deviations (of the noise, and of its neighbours from a parabola) by which a reading must miss its stamp, and the
share of that miss that may remain."""


def early(time: Array, position: Array, sigma: float) -> tuple[Array, Array]:
    """Readings that were taken before a hiccup and stamped after it.

    Args:
        time, position: [T] of one joint. sigma: noise of the positions.

    Returns:
        Their rows [K], and how far the joint moved [K] between reading and stamp.
    """
    step = np.diff(time)
    usual = float(np.median(step))
    rows = np.flatnonzero((step > HICCUP * usual) & (step < GAP * usual)) + 1
    around = np.r_[-NEIGHBOURS:0, 1 : NEIGHBOURS + 1]
    rows = rows[(rows >= NEIGHBOURS) & (rows < time.size - NEIGHBOURS)]
    found, moved = [], []
    for k in rows:
        near = k + around
        # hiccups come in bursts: neighbours may be early themselves
        near = near[~np.isin(near, rows)]
        if near.size < NEIGHBOURS:
            continue
        at = time[near] - time[k]
        curve = np.polynomial.Polynomial.fit(at, position[near], 2)
        spread = float(np.sqrt(np.mean((curve(at) - position[near]) ** 2)))
        back = time[k - 1] + usual - time[k]
        miss, rest = (abs(position[k] - float(curve(x))) for x in (0.0, back))
        if miss > WRONG * max(sigma, spread) and rest < RIGHT * miss:
            found.append(int(k))
            moved.append(float(curve(0.0) - curve(back)))
    return np.array(found, int), np.array(moved)


def at_their_stamps(
    recordings: list[Recording], model: mujoco.MjModel, names: Names
) -> tuple[list[Recording], list[str]]:
    """The recordings with early positions moved on to where the joint was at their stamps, and warnings. Velocities and
    forces of those rows stay as they are: they change less within a step."""
    counts: dict[str, int] = {}
    out = []
    for r in recordings:
        qpos = r.qpos.copy()
        for j in range(model.njnt):
            column = int(model.jnt_qposadr[j])
            if not is_scalar(model, j) or r.time.size < MIN_ROWS or np.isnan(qpos[:, column]).any():
                continue
            rows, moved = early(r.time, r.qpos[:, column], noise_level(r.time, r.qpos[:, column]))
            if rows.size:
                qpos[rows, column] += moved
                counts[names.joints[j]] = counts.get(names.joints[j], 0) + rows.size
        out.append(replace(r, qpos=qpos))
    return out, [
        f"{n} readings of {name} were taken before the clock was held up, but stamped after it: they are moved on "
        "to their stamps."
        for name, n in counts.items()
    ]
