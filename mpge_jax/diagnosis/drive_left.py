"""What no law of a drive explains between its commands and its measured forces."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.drive_fit import Data, Log, blocks_of, predict
from mpge_jax.diagnosis.effects.base import Context
from mpge_jax.diagnosis.evidence import SEVERAL
from mpge_jax.diagnosis.fitted import NOTHING, Fitted

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
    by_block, starts = blocks_of(np.concatenate(missed), d.held), np.cumsum([0, *_counts(d.held)[:-1]])
    later = np.setdiff1d(np.arange(by_block.size), starts)
    kept = later[np.argsort(by_block[later])][: later.size - SEVERAL + 1]
    if not kept.size:
        return None
    left = float(by_block[kept].mean()) - d.sigma**2
    before = max(float(blocks_of(nominal, d.held)[kept].mean()), 1e-300)
    if left < max(SEEN * float(ctx.drive[a]), MISSED * np.sqrt(before), 2.0 * d.sigma) ** 2:
        return None
    parts = []
    for log, miss in zip(d.held, missed, strict=True):
        for block in np.unique(log.block):
            mine = log.block == block
            first, last = log.time[mine][[0, -1]]
            parts.append((float(np.mean(miss[mine] ** 2)), [log.name, round(first, 4), round(last, 4)]))
    worst = sorted((parts[k] for k in later), key=lambda x: -x[0])[:WORST]
    return {
        "when": "between its command and its measured force",
        "intervals": sorted((x[1] for x in worst), key=lambda x: (x[0], x[1])),
        "share": min(left / before, 1.0),
        "of": "force",
    }


def _counts(logs: list[Log]) -> list[int]:
    """How many blocks each log has."""
    return [np.unique(log.block).size for log in logs]
