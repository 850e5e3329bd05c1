"""Where windows start, told by a model from their first rows: those rows are not what it is judged by.

A smoother that knows no physics may follow what shakes a machine, and miss by far the velocity with which it goes on.
From there even the true model goes wrong. So each model tells the starts by itself, as identification usually does:
those from which it goes through a window's first rows best, within what the rows before leave open.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.whitening import KAPPA, in_units, row_scale, start_runs
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.cheaper_steps import changes
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
ROUNDS = 6
SHORTER = (1.0, 0.4, 0.1)
"""Parts of a Gauss-Newton step that are tried: through contacts slopes do not carry far."""
NEGLIGIBLE = 0.01
"""Fall of the cost, a chi^2, for which no further step is made."""
FAR = 1e6
"""Deviations of the noise beyond which a residual counts as so many."""


def told(sim: Simulator, f: Fitted, w: Windows, noise: Noise, near: Fitted | None = None) -> Windows:
    """The windows from where `f` goes through their first rows best; as they are where none are kept for that.

    The cost of a start is chi^2 of those rows and of its distance from the estimate in `KAPPA` of its deviations.
    Slopes of smooth machines hardly change so near: they are told once.

    Args:
        near: a fit near `f` whose slopes serve for its own where the machine is smooth.
    """
    if not w.lead.any():
        return w
    rugged = sim.rugged(f.hypothesis)
    guide = f if near is None or rugged or sim.rugged(near.hypothesis) else near
    first, z = w.leading(), w.moved.reshape(w.count, -1).copy()
    (left,), (cost,) = _left(sim, f, first, noise, z[None])
    going, columns = np.arange(w.count), None
    for _ in range(ROUNDS):
        here = first.take(going)
        if columns is None or rugged:
            columns = _columns(sim, guide, replace(here, moved=z[going].reshape(here.moved.shape)), noise)
        step, before = _step(columns, left[going], z[going]), cost[going]
        # where slopes carry far, shorter steps serve those windows alone that a whole one does not
        for shares in [SHORTER] if rugged else [SHORTER[:1], SHORTER[1:]]:
            (rest,) = np.nonzero(cost[going] >= before)
            if not rest.size:
                break
            at = going[rest]
            tried = np.stack([z[at] + x * step[rest] for x in shares])
            each, costs = _left(sim, f, here.take(rest), noise, tried)
            best, rows = costs.argmin(0), np.arange(rest.size)
            better = costs[best, rows] < cost[at]
            moved = at[better]
            z[moved], left[moved], cost[moved] = (x[best, rows][better] for x in (tried, each, costs))
        onward = before - cost[going] > NEGLIGIBLE
        if not onward.any():
            break
        going, columns = going[onward], columns[:, onward]
    return replace(w, moved=z.reshape(w.moved.shape))


def left_open(sim: Simulator, f: Fitted, w: Windows, noise: Noise) -> Array:
    """Covariance [W, s, s] of the starts `told`, in columns of `root`, if the noise is as large as is said."""
    size = 2 * w.v0.shape[1]
    if not w.lead.any():
        return np.broadcast_to(np.eye(size), (w.count, size, size))
    columns = _columns(sim, f, w.leading(), noise)
    return np.linalg.inv(np.eye(size) + np.einsum("swm,twm->wst", columns, columns, optimize=True))


def _plain(residual: Array, scale: Array) -> Array:
    """Residuals [..., W, N, 2 nv] in units of noise [W, N, 2 nv]: [..., W, M], zero where nothing was measured."""
    return np.clip(in_units(residual, scale), -FAR, FAR)


def _columns(sim: Simulator, f: Fitted, w: Windows, noise: Noise) -> Array:
    """[s, W, M] what a deviation of each start changes."""
    moved = changes(sim, start_runs(f.hypothesis, f.theta, w), w)
    return _plain(moved, row_scale(noise, sim.model, w))


def _step(columns: Array, left: Array, z: Array) -> Array:
    """[W, s] by a Gauss-Newton step from starts `z` [W, s] that leave `left` [W, M]."""
    gram = np.einsum("swm,twm->wst", columns, columns, optimize=True) + np.eye(z.shape[1]) / KAPPA**2
    push = np.einsum("swm,wm->ws", columns, left, optimize=True) + z / KAPPA**2
    return -np.linalg.solve(gram, push[..., None])[..., 0]


def _left(sim: Simulator, f: Fitted, w: Windows, noise: Noise, z: Array) -> tuple[Array, Array]:
    """What the starts `z` [R, W, s] leave [R, W, M], and their costs [R, W]."""
    still = replace(w, moved=np.zeros_like(w.moved))
    shifts = (replace(w, moved=x.reshape(w.moved.shape)).shift for x in z)
    residual = sim.residuals([Run(f.hypothesis, f.theta, shift) for shift in shifts], still)
    left = _plain(residual, row_scale(noise, sim.model, w))
    return left, (left**2).sum(-1) + (z**2).sum(-1) / KAPPA**2
