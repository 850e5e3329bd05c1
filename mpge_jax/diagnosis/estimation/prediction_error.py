"""Errors of open-loop prediction over windows, and what noise alone would make of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.whitening import start_runs
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.near import changes
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray


@dataclass(frozen=True)
class Errors:
    """Root-mean-square open-loop errors over windows.

    Attributes:
        rms: over all position columns. joint: [nv] per degree of freedom (NaN where unmeasured).
        window: [W] per window. curves: [W, N, nv] measured minus predicted.
    """

    rms: float
    joint: Array
    window: Array
    curves: Array


def errors(sim: Simulator, f: Fitted, w: Windows) -> Errors:
    """Open-loop prediction errors of positions in joint space."""
    nv = sim.model.nv
    residual = sim.residuals([Run(f.hypothesis, f.theta)], w)[0][..., :nv]
    square = np.clip(residual, -1e3, 1e3) ** 2
    seen = np.isfinite(square)
    filled = np.where(seen, square, 0.0)
    total = np.maximum(seen.sum(), 1)
    per_joint = np.where(seen.any((0, 1)), filled.sum((0, 1)) / np.maximum(seen.sum((0, 1)), 1), np.nan)
    per_window = filled.sum((1, 2)) / np.maximum(seen.sum((1, 2)), 1)
    return Errors(float(np.sqrt(filled.sum() / total)), np.sqrt(per_joint), np.sqrt(per_window), residual)


def noise_floor(sim: Simulator, f: Fitted, w: Windows, scale: Array) -> Array:
    """Variance that measurement noise and uncertain start states alone would give each window [W], were they
    independent: mean square over position columns."""

    nv = sim.model.nv
    moved = changes(sim, start_runs(f.hypothesis, f.theta, w), w)[..., :nv]
    seen = np.isfinite(moved[0])
    spread = np.where(seen, np.clip(moved, -1e3, 1e3), 0.0)
    variance = (spread**2).sum(0) + np.where(seen, scale[:nv] ** 2, 0.0)
    return np.where(seen, variance, 0.0).sum((1, 2)) / np.maximum(seen.sum((1, 2)), 1)
