"""Where windows start, told by a model from their first rows: those rows are not what it is judged by.

A smoother that knows no physics may follow what shakes a machine, and miss by far the velocity with which it goes on.
From there even the true model goes wrong. So each model tells the starts by itself, as identification usually does:
those from which it goes through a window's first rows best, within what the rows before leave open.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.whitening import KAPPA, start_runs
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.cheaper_steps import changes
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
ROUNDS = 3
SHORTER = (1.0, 0.4, 0.1)
"""Parts of a Gauss-Newton step that are tried: through contacts slopes do not carry far."""
FAR = 1e6
"""Deviations of the noise beyond which a residual counts as so many."""


def told(sim: Simulator, f: Fitted, w: Windows, scale: Array) -> Windows:
    """The windows from where `f` goes through their first rows best; as they are where none are kept for that.

    The cost of a start is chi^2 of those rows and of its distance from the estimate in `KAPPA` of its deviations.

    Args:
        scale: [2 nv] deviations of the noise (`whitening.column_scale`).
    """
    if not w.lead.any():
        return w
    first = w.leading()
    z = w.moved.reshape(w.count, -1)
    cost = _costs(sim, f, first, scale, z[None])[0]
    for _ in range(ROUNDS):
        step = _step(sim, f, first, scale, z)
        tried = np.stack([z + x * step for x in SHORTER])
        costs = _costs(sim, f, first, scale, tried)
        best, rows = costs.argmin(0), np.arange(w.count)
        better = costs[best, rows] < cost
        if not better.any():
            break
        z = np.where(better[:, None], tried[best, rows], z)
        cost = np.where(better, costs[best, rows], cost)
    return replace(w, moved=z.reshape(w.moved.shape))


def left_open(sim: Simulator, f: Fitted, w: Windows, scale: Array) -> Array:
    """Covariance [W, s, s] of the starts `told`, in columns of `root`, if the noise is as large as is said."""
    size = 2 * w.v0.shape[1]
    if not w.lead.any():
        return np.broadcast_to(np.eye(size), (w.count, size, size))
    columns = _columns(sim, f, w.leading(), scale)
    return np.linalg.inv(np.eye(size) + np.einsum("swm,twm->wst", columns, columns, optimize=True))


def _plain(residual: Array, scale: Array) -> Array:
    """Residuals [..., W, N, 2 nv] in units of noise [..., W, M], zero where nothing was measured."""
    x = np.where(np.isfinite(residual) & np.isfinite(scale), residual / scale, 0.0)
    return np.clip(x, -FAR, FAR).reshape(*x.shape[:-2], -1)


def _columns(sim: Simulator, f: Fitted, w: Windows, scale: Array) -> Array:
    """[s, W, M] what a deviation of each start changes."""
    return _plain(changes(sim, start_runs(f.hypothesis, f.theta, w), w), scale)


def _step(sim: Simulator, f: Fitted, w: Windows, scale: Array, z: Array) -> Array:
    here = replace(w, moved=z.reshape(w.moved.shape))
    base = _plain(sim.residuals([Run(f.hypothesis, f.theta)], here)[0], scale)
    columns = _columns(sim, f, here, scale)
    gram = np.einsum("swm,twm->wst", columns, columns, optimize=True) + np.eye(z.shape[1]) / KAPPA**2
    push = np.einsum("swm,wm->ws", columns, base, optimize=True) + z / KAPPA**2
    return -np.linalg.solve(gram, push[..., None])[..., 0]


def _costs(sim: Simulator, f: Fitted, w: Windows, scale: Array, z: Array) -> Array:
    """[R, W] of the starts `z` [R, W, s]."""
    still = replace(w, moved=np.zeros_like(w.moved))
    shifts = (replace(w, moved=x.reshape(w.moved.shape)).shift for x in z)
    flat = _plain(sim.residuals([Run(f.hypothesis, f.theta, shift) for shift in shifts], still), scale)
    return (flat**2).sum(-1) + (z**2).sum(-1) / KAPPA**2
