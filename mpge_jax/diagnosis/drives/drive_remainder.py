"""What no law of a drive explains between its commands and its measured forces."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.drives.drive_law import Data, Log, blocks_of, predict
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.thresholds import SEVERAL

Array = np.ndarray
MISSED, SEEN = 0.1, 0.01
"""Share of what the nominal law misses, and of an actuator's largest forces, that a law must miss (root mean square)
for something to be left."""
WORST = 8
"""Stretches of recordings that are listed where something is left."""


def outside(model: mujoco.MjModel, ctx: Context, f: Fitted, a: int, log: Log, dt: float) -> Array:
    """By how much [T] each measured force lies outside what `f` predicts for it and its neighbours in time: nobody
    knows to a row when a force was measured."""
    force = predict(model, ctx, f, a, log, dt)
    near = np.stack([force, np.append(force[1:], force[-1]), np.append(force[0], force[:-1])])
    return np.maximum(np.maximum(near.min(0) - log.force, log.force - near.max(0)), 0.0)


def unexplained_drive(
    model: mujoco.MjModel, ctx: Context, f: Fitted, a: int, d: Data
) -> dict[str, Any] | None:
    """The `unexplained` entry of a drive whose held-out forces `f` misses, whatever the timing, by more than noise
    and by much of what the nominal law misses."""
    missed = [outside(model, ctx, f, a, log, d.dt) for log in d.held]
    nominal = np.concatenate([log.force - predict(model, ctx, NOTHING, a, log, d.dt) for log in d.held])
    # nobody knows what came before a log, and what a moment or two show alone (a limit reached once) is no law
    by_block = blocks_of(np.concatenate(missed), d.held)
    blocks = [(log, block) for log in d.held for block in np.unique(log.block)]
    later = np.array([k for k, (log, block) in enumerate(blocks) if block != log.block[0]], dtype=int)
    kept = later[np.argsort(by_block[later])][: later.size - SEVERAL + 1]
    if not kept.size:
        return None
    left = float(by_block[kept].mean()) - d.sigma**2
    before = max(float(blocks_of(nominal, d.held)[kept].mean()), 1e-300)
    if left < max(SEEN * float(ctx.drive[a]), MISSED * np.sqrt(before), 2.0 * d.sigma) ** 2:
        return None
    intervals = []
    for k in sorted(later, key=lambda k: -by_block[k])[:WORST]:
        log, block = blocks[k]
        first, last = log.time[log.block == block][[0, -1]]
        intervals.append([log.name, round(first, 4), round(last, 4)])
    return {
        "when": "between its command and its measured force",
        "intervals": sorted(intervals),
        "share": min(left / before, 1.0),
        "of": "force",
    }
