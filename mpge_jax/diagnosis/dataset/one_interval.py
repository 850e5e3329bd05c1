"""What predictions over one interval between rows miss, and how much of that can be noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.missing_force import pushes
from mpge_jax.diagnosis.estimation.whitening import in_units
from mpge_jax.diagnosis.machine.joint_space import integrate
from mpge_jax.diagnosis.recordings.measurement_noise import SIGMA_FLOOR, SIGMA_VELOCITY_FLOOR
from mpge_jax.diagnosis.recordings.noise_level import MAD
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
ROUNDS, LEAST = 8, 0.3
"""How often the noise of one row is estimated from what it leads to, and the least share of a miss that it is."""
TAKEN = 0.9
"""Share of a number's noise that forces fitted to it take, from which on it tells nothing of that."""


@dataclass(frozen=True)
class Assumed:
    """What a machine lacks: effects, and in each interval a force of any size at some degrees of freedom."""

    fit: Fitted = NOTHING
    pushed: tuple[int, ...] = ()


def least_misses(nv: int) -> Array:
    """The least miss [2 nv]."""
    return np.repeat([SIGMA_FLOOR, SIGMA_VELOCITY_FLOOR], nv)


def mean_logarithm(missed: Array) -> float:
    """Of misses [2 nv], where they are told."""
    seen = np.isfinite(missed)
    return float(np.mean(np.log(missed[seen]))) if seen.any() else 0.0


def misses(sim: Simulator, assumed: Assumed, w: Windows, before: Array | None = None) -> Array:
    """Typical miss [2 nv] by column; infinite where nothing was measured.

    Args:
        before: misses by which columns are weighed where forces are fitted to them.
    """
    residual = _residual(sim, assumed.fit, w)
    if not assumed.pushed:
        return np.maximum(_typical(residual), least_misses(sim.model.nv))
    assert before is not None
    left = _typical(_beside_forces(sim, assumed, w, before)(residual))
    return np.maximum(np.minimum(_as_others(sim.model, left), before), least_misses(sim.model.nv))


def _as_others(model: mujoco.MjModel, missed: Array) -> Array:
    """Misses [2 nv], where nothing tells one (infinite) the largest of joints of its kind: encoders are much alike."""
    out = missed.reshape(2, model.nv).copy()
    kinds = model.jnt_type[model.dof_jntid]
    for row in out:
        for kind in np.unique(kinds):
            of = kinds == kind
            told = row[of & np.isfinite(row)]
            row[of & np.isinf(row)] = told.max(initial=0.0) or np.inf
    return out.ravel()


def of_one_row(sim: Simulator, assumed: Assumed, w: Windows, before: Array, seed: int) -> Array:
    """Noise [2 nv] of one row, by column, if nothing else makes predictions miss: they do by the noise of the row that
    they are compared with, and by what the noise of the row that they start from has become."""
    nv, rng = sim.model.nv, np.random.default_rng([seed, 13])
    missed = misses(sim, assumed, w, before)
    known = np.where(np.isfinite(missed), missed, 0.0)
    own, sigma = _residual(sim, assumed.fit, w), known / np.sqrt(2.0)
    beside = _beside_forces(sim, assumed, w, missed)
    drawn = rng.standard_normal((w.count, 2 * nv))
    for _ in range(ROUNDS):
        change = sigma * drawn
        moved = replace(w, q0=integrate(sim.model, w.q0, change[:, :nv]), v0=w.v0 + change[:, nv:])
        became = _typical(beside(_residual(sim, assumed.fit, moved) - own))
        rest = known**2 - np.where(np.isfinite(became), became, 0.0) ** 2
        # half of the way: too much noise in one column leaves too little for the next round of the others
        sigma = np.sqrt(0.5 * (sigma**2 + np.maximum(rest, (LEAST * known) ** 2)))
    return np.where(np.isfinite(missed), np.maximum(sigma, least_misses(nv)), missed)


def _residual(sim: Simulator, f: Fitted, w: Windows) -> Array:
    return sim.residuals([Run(f.hypothesis, f.theta)], w)[0]


def _beside_forces(sim: Simulator, assumed: Assumed, w: Windows, before: Array) -> Callable[[Array], Array]:
    """Takes from residuals [W, N, 2 nv] what constant forces explain best in every interval, and makes the rest as
    large as noise is of which that much was taken; NaN where that is nearly all."""
    if not assumed.pushed:
        return np.asarray
    _, runs = pushes(sim, assumed.fit, assumed.pushed)
    plain, *pushed = in_units(sim.residuals(runs, w), before)
    basis, singular, _ = np.linalg.svd(np.stack(pushed, -1) - plain[..., None], full_matrices=False)
    basis = basis * (singular > 1e-9 * singular.max(-1, keepdims=True))[:, None]
    taken = (basis**2).sum(-1)

    def left(residual: Array) -> Array:
        flat = in_units(residual, before)
        rest = flat - np.einsum("wmk,wnk,wn->wm", basis, basis, flat, optimize=True)
        rest = np.where(taken < TAKEN, rest / np.sqrt(np.maximum(1.0 - taken, 1e-9)), np.nan)
        known = np.isfinite(residual) & np.isfinite(before)
        return np.where(known, rest.reshape(residual.shape) * np.where(known, before, 0.0), np.nan)

    return left


def _typical(residual: Array) -> Array:
    """Deviation [2 nv] of the usual residual [W, N, 2 nv] by column; infinite where nothing was measured."""
    out = np.full(residual.shape[-1], np.inf)
    for c in range(out.size):
        value = np.abs(residual[..., c][np.isfinite(residual[..., c])])
        if value.size:
            out[c] = MAD * float(np.median(value))
    return out
