"""Errors of open-loop prediction over windows, and what noise alone would make of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.told_starts import left_open, told
from mpge_jax.diagnosis.estimation.whitening import numerics, row_scale, start_runs
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.cheaper_steps import changes
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
DRAWS = 4
"""Draws of the noise in measured forces."""
NO_AMOUNTS: Mapping[str, float] = MappingProxyType({})


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

    @property
    def each(self) -> Array:
        """[W, nv] per window and degree of freedom (NaN where unmeasured)."""
        return _rms(np.clip(self.curves, -1e3, 1e3), (1,))


@dataclass(frozen=True)
class MeanSquare:
    """Mean squares of position errors.

    Attributes:
        window: [W] of each window, over all position columns. joint: [nv] of each degree of freedom, over all windows
            (0 where nothing is compared).
    """

    window: Array
    joint: Array

    @staticmethod
    def of(square: Array, seen: Array) -> MeanSquare:
        """Of squares [W, N, nv] where they are `seen`."""
        filled = np.where(seen, square, 0.0)
        each = (filled.sum(axes) / np.maximum(seen.sum(axes), 1) for axes in ((1, 2), (0, 1)))
        return MeanSquare(*each)

    def __add__(self, other: MeanSquare) -> MeanSquare:
        return MeanSquare(self.window + other.window, self.joint + other.joint)


def errors(
    sim: Simulator,
    f: Fitted,
    w: Windows,
    noise: Noise,
    amounts: Mapping[str, float] = NO_AMOUNTS,
    near: Fitted | None = None,
) -> Errors:
    """Open-loop prediction errors of positions in joint space, from starts that `f` itself tells (`told_starts`).

    Args:
        amounts: how much of each of `numerics` predictions are to have. near: as in `told`.
    """
    nv = sim.model.nv
    w = told(sim, f, w, noise, near)
    residual = sim.residuals([Run(f.hypothesis, f.theta)], w)[0][..., :nv]
    if any(amounts.values()):
        residual = residual + _numerical_moves(sim, f, w, noise, amounts)
    clipped = np.clip(residual, -1e3, 1e3)
    square = clipped**2
    seen = np.isfinite(square)
    filled = np.where(seen, square, 0.0)
    total = np.maximum(seen.sum(), 1)
    per_window = filled.sum((1, 2)) / np.maximum(seen.sum((1, 2)), 1)
    return Errors(float(np.sqrt(filled.sum() / total)), rms_by_joint(clipped), np.sqrt(per_window), residual)


def rms_by_joint(x: Array) -> Array:
    """Rms [nv] over windows and rows of something [W, N, nv] where it is finite (NaN where it never is)."""
    return _rms(x, (0, 1))


def _rms(x: Array, axes: tuple[int, ...]) -> Array:
    seen = np.isfinite(x)
    square = np.where(seen, x, 0.0) ** 2
    return np.sqrt(np.where(seen.any(axes), square.sum(axes) / np.maximum(seen.sum(axes), 1), np.nan))


def noise_floor(sim: Simulator, f: Fitted, w: Windows, noise: Noise, shaken: Array) -> MeanSquare:
    """Variance that noise and uncertain start states alone would give positions, were they independent.

    Args:
        shaken: [nu] deviation of the noise in measured forces that drive the machine; 0 where commands do.
    """
    nv, scale = sim.model.nv, row_scale(noise, sim.model, w)
    w = told(sim, f, w, noise)
    moved = changes(sim, start_runs(f.hypothesis, f.theta, w), w)[..., :nv]
    seen = np.isfinite(moved[0])
    spread = np.where(seen, np.clip(moved, -1e3, 1e3), 0.0)
    cov = left_open(sim, f, w, noise)
    starts = np.einsum("swnd,wst,twnd->wnd", spread, cov, spread, optimize=True)
    variance = starts + np.where(seen, scale[..., :nv] ** 2, 0.0)
    square = MeanSquare.of(variance, seen)
    return square + _shaken_floor(sim, f, w, noise, shaken) if shaken.any() else square


def _shaken_floor(sim: Simulator, f: Fitted, w: Windows, noise: Noise, shaken: Array) -> MeanSquare:
    """Errors of positions as noise in the forces of every row makes them; `w` as in `_from_told_starts`."""
    rng, run = np.random.default_rng(0), [Run(f.hypothesis, f.theta)]

    def drawn(whole: Windows) -> list[Array]:
        own = sim.residuals(run, whole)[0]
        again = [whole.driven_by(tuple(s.shaken(shaken, rng) for s in whole.sources)) for _ in range(DRAWS)]
        return [sim.residuals(run, each)[0] - own for each in again]

    square = np.mean([x**2 for x in _from_told_starts(sim, f, w, noise, drawn)], axis=0)
    return _mean_square(square, w)


def numerical_floor(
    sim: Simulator, f: Fitted, w: Windows, noise: Noise, amounts: Mapping[str, float]
) -> MeanSquare:
    """Errors of positions as the recordings move with another timestep, integrator or moment of the commands than the
    model's, from starts that follow that.

    Args:
        amounts: how much of each of `numerics` the recordings show.
    """
    if not any(amounts.values()):
        return MeanSquare(np.zeros(w.count), np.zeros(sim.model.nv))
    w = told(sim, f, w, noise)
    return _mean_square(_numerical_moves(sim, f, w, noise, amounts) ** 2, w)


def _numerical_moves(
    sim: Simulator, f: Fitted, w: Windows, noise: Noise, amounts: Mapping[str, float]
) -> Array:
    """[W, N, nv] by which such amounts of `numerics` change the residual; `w` as in `_from_told_starts`."""

    def change(whole: Windows) -> list[Array]:
        changed = numerics(sim, f.hypothesis, f.theta, whole)
        moves = [a * changed[kind] for kind, a in amounts.items() if kind in changed]
        return [np.sum([np.zeros((*whole.seen.shape, 2 * sim.model.nv)), *moves], axis=0)]

    return _from_told_starts(sim, f, w, noise, change)[0]


def _mean_square(square: Array, w: Windows) -> MeanSquare:
    """Of squares [W, N, nv] of how the positions move that are compared."""
    return MeanSquare.of(square, np.broadcast_to(w.seen[..., None], square.shape))


def _from_told_starts(
    sim: Simulator, f: Fitted, w: Windows, noise: Noise, drawn: Callable[[Windows], list[Array]]
) -> list[Array]:
    """By how much changes [W, N, 2 nv] of the residual move the positions' one [W, N, nv], from starts that follow
    them.

    Args:
        w: from starts that `f` has `told`.
    """
    nv, scale = sim.model.nv, row_scale(noise, sim.model, w)
    cov = left_open(sim, f, w, noise)
    whole = replace(w, seen=w.seen | w.lead, lead=np.zeros_like(w.lead))
    columns = np.nan_to_num(changes(sim, start_runs(f.hypothesis, f.theta, whole), whole))
    known = np.where(w.lead[..., None] & np.isfinite(scale), 1.0 / scale**2, 0.0)
    moved = []
    for change in drawn(whole):
        d = np.clip(np.nan_to_num(change), -1e3, 1e3)
        follows = -np.einsum("wst,twnd,wnd->ws", cov, columns, known * d, optimize=True)
        moved.append((d + np.einsum("swnd,ws->wnd", columns, follows, optimize=True))[..., :nv])
    return moved
