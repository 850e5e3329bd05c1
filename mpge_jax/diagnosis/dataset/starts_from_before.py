"""Windows that start from what was recorded before the rows that they are judged by."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.cut_windows import factors
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.recordings.recording import rows_of
from mpge_jax.diagnosis.recordings.states import smoothed
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
LEAD = 0.2
"""Share of a window's rows, its first ones, that tell where it starts and are not compared."""
BACK, FEWEST = 48, 4
"""Rows before the start that tell it too, and rows that a velocity takes."""


def started_from_before(
    w: Windows, model: mujoco.MjModel, noise: Noise, seconds: float | None = None
) -> Windows:
    """The same windows, each with the start that the rows before it tell. Its first rows are left to tell it better,
    through a model (`estimation.told_starts`), and are not compared.

    Nothing is changed where the measurements themselves are taken for states.

    Args:
        seconds: how long a window's first rows are; None: a fifth of it.
    """
    if noise.direct or not w.count:
        return w
    pieces, jumps, at, until = [], list[Array | None](), [], np.zeros(w.count)
    for k in range(w.count):
        r = w.sources[w.source[k]].recording
        a = int(np.searchsorted(r.time, w.start[k] - 1e-9))
        first = max(0, a - BACK)
        # where a recording begins there is nothing before
        last = max(a, first + FEWEST - 1)
        rows = slice(first, last + 1)
        pieces.append(rows_of(r, rows, r.name))
        jumps.append(w.sources[w.source[k]].states.jumps_in(rows))
        at.append(a - first)
        length = w.times[k].max()
        until[k] = max(
            LEAD * length if seconds is None else min(seconds, length / 2), r.time[last] - w.start[k]
        )
    states = smoothed(pieces, model, noise, jumps)
    lead = w.seen & (w.times <= until[:, None] + 1e-9)
    return replace(
        w,
        q0=np.array([s.qpos[i] for s, i in zip(states, at, strict=True)]),
        v0=np.array([s.qvel[i] for s, i in zip(states, at, strict=True)]),
        root=np.array([factors(s.cov[i]) for s, i in zip(states, at, strict=True)]),
        seen=w.seen & ~lead,
        lead=lead,
    )
