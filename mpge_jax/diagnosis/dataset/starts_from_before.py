"""Starts of windows from what was recorded before the rows that they are judged by."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.recordings.recording import rows_of
from mpge_jax.diagnosis.recordings.states import Noise, smoothed
from mpge_jax.diagnosis.simulation.windows import Windows, factors

LEAD = 0.2
"""Share of a window's rows, its first ones, that tell where it starts and are not compared."""
BACK, FEWEST = 48, 4
"""Rows before the start that tell it too, and rows that a velocity takes."""


def started_from_before(w: Windows, model: mujoco.MjModel, noise: Noise) -> Windows:
    """The same windows, each started from the rows before it and the first fifth of its own, and compared with those
    that come after. Nothing is changed where the measurements themselves are taken for states."""
    if noise.direct or not w.count:
        return w
    pieces, at, since = [], [], np.zeros(w.count)
    for k in range(w.count):
        r = w.sources[w.source[k]].recording
        a = int(np.searchsorted(r.time, w.start[k] - 1e-9))
        b = int(np.searchsorted(r.time, w.start[k] + w.times[k].max() + 1e-9, side="right")) - 1
        first = max(0, a - BACK)
        last = max(a + int(LEAD * (b - a)), min(first + FEWEST - 1, b - 1))
        pieces.append(rows_of(r, slice(first, last + 1), r.name))
        at.append(a - first)
        since[k] = r.time[last] - w.start[k]
    states = smoothed(pieces, model, noise)
    seen = w.seen & (w.times > since[:, None] + 1e-9)
    hidden = ~seen[..., None]
    return replace(
        w,
        q0=np.array([s.qpos[i] for s, i in zip(states, at, strict=True)]),
        v0=np.array([s.qvel[i] for s, i in zip(states, at, strict=True)]),
        root=np.array([factors(s.cov[i]) for s, i in zip(states, at, strict=True)]),
        seen=seen,
        qpos=np.where(hidden, np.nan, w.qpos),
        qvel=np.where(hidden, np.nan, w.qvel),
    )
