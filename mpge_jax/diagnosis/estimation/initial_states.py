"""Where windows start, told anew from how a hypothesis goes on from there.

Whitening marginalises the start by slopes. Through contacts these do not carry far: a foot that is a tenth of a
millimetre lower lands a step earlier, sticks instead of slipping, and the window ends elsewhere than any slope says.
What looks like a remainder then may be a start within what the smoother leaves open.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate
from mpge_jax.diagnosis.estimation.whitening import KAPPA, Whitener, nuisances, whitener, whitener_beside
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.windows import Windows
from mpge_jax.diagnosis.thresholds import ELSEWHERE_FROM, MANY_ELSEWHERE

Array = np.ndarray
ROUNDS, DRAWS = 6, 8
"""Rounds of a search, and starts that are drawn at random in each."""
DAMPING = (0.0, 0.1, 1.0, 10.0)
"""Damping of their steps, relative to the curvature."""
ROUNDING = 1e-12
"""The least damping with which a step can be told."""
GROW, SHRINK, NARROW = 1.2, 0.7, 0.02
"""Change of the draws' width after rounds that found a better start, or none, and its least value (deviations)."""
STUBBORN, ELSEWHERE = 8, 8
"""Windows at most that are searched from elsewhere too, and from how many starts each."""


def settled(
    sim: Simulator,
    f: Fitted,
    w: Windows,
    noise: Noise,
    ordinary: float = ELSEWHERE_FROM,
    elsewhere: bool = False,
    seed: int = 0,
) -> Windows:
    """`w`, with those windows moved within their starts' uncertainty that `f` does not explain from where they are.

    The cost is that of whitening (chi^2 of the residual with nuisance directions marginalised, and of the start with
    `KAPPA` times the smoother's deviations), but without its slopes.

    Args:
        ordinary: relative chi^2 of windows that stay as they are. elsewhere: search the worst few windows, each from
            several starts drawn at random, and not all from where they are.
    """
    nuisance = nuisances(sim, f.hypothesis, f.theta, w)
    whole = whitener(sim, f.hypothesis, f.theta, w, noise, nuisance, temper=False)
    x = evaluate(sim, [f], w, whole)[0].x
    odd = np.flatnonzero(x > ordinary)
    if not 0 < odd.size <= MANY_ELSEWHERE * w.count:
        return w
    rng, often = np.random.default_rng([seed, 23]), 1
    if elsewhere:
        odd, often = odd[np.argsort(-x[odd], kind="stable")[:STUBBORN]], ELSEWHERE
    fixed = replace(w, root=np.zeros_like(w.root), moved=np.zeros_like(w.moved))
    white = whitener(sim, f.hypothesis, f.theta, fixed, noise, nuisance, temper=False)
    each = np.repeat(odd, often)
    from_here = w.take(each)
    if elsewhere:
        from_here = replace(from_here, moved=rng.standard_normal(from_here.moved.shape))
    tried, costs = _search(sim, f, from_here, white.take(each), ordinary * whole.expected[each], rng)
    best = costs.reshape(odd.size, often).argmin(1) + often * np.arange(odd.size)
    moved = w.moved.copy()
    moved[odd] = tried[best]
    new = replace(w, moved=moved)
    white = whitener_beside(sim, f.hypothesis, f.theta, new, noise, temper=False)
    better = evaluate(sim, [f], new, white)[0].x < x
    return replace(w, moved=np.where(better[:, None, None], moved, w.moved)) if better.any() else w


def _search(
    sim: Simulator, f: Fitted, w: Windows, white: Whitener, enough: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Better starts [W, nv, 2] of the windows, from where they are, and their costs [W] for each compared value: damped
    Gauss-Newton steps, and draws around the best so far, until the costs are `enough` [W]."""
    z = w.moved.reshape(w.count, -1).copy()
    cost, width = _costs(sim, f, w, white, z[None])[1][0], np.ones(w.count)
    for _ in range(ROUNDS):
        on = np.flatnonzero(cost > enough)
        if not on.size:
            break
        part, white_part = w.take(on), white.take(on)
        tried = _candidates(sim, f, part, white_part, z[on], width[on], rng)
        costs = _costs(sim, f, part, white_part, tried)[1]
        best, rows = costs.argmin(0), np.arange(on.size)
        better = costs[best, rows] < cost[on]
        z[on[better]], cost[on[better]] = tried[best, rows][better], costs[best, rows][better]
        width[on] = np.maximum(width[on] * np.where(better, GROW, SHRINK), NARROW)
    return z.reshape(w.moved.shape), cost


def _candidates(
    sim: Simulator, f: Fitted, w: Windows, white: Whitener, z: Array, width: Array, rng: np.random.Generator
) -> Array:
    """Starts to try [C, W, s] around `z` [W, s]."""
    count, size = z.shape
    steps = np.eye(size)[:, None, :] * width[:, None]
    flat, _ = _costs(sim, f, w, white, np.concatenate([z[None], z + steps]))
    slopes = (flat[1:] - flat[0]) / width[:, None]
    gram = np.einsum("swm,twm->wst", slopes, slopes, optimize=True) + np.eye(size) / KAPPA**2
    push = np.einsum("swm,wm->ws", slopes, flat[0], optimize=True) + z / KAPPA**2
    weight = np.einsum("wss->ws", gram)
    out = []
    for damping in DAMPING:
        h = gram + (damping + ROUNDING) * weight[:, :, None] * np.eye(size)
        out.append(z - np.linalg.solve(h, push[..., None])[..., 0])
    draws = rng.standard_normal((DRAWS, count, size)) * width[:, None]
    return np.concatenate([np.array(out), z + draws])


def _costs(sim: Simulator, f: Fitted, w: Windows, white: Whitener, z: Array) -> tuple[Array, Array]:
    """Whitened residuals [R, W, M] from starts `z` [R, W, s], and their costs [R, W] for each compared value."""
    still = replace(w, moved=np.zeros_like(w.moved))
    runs = [Run(f.hypothesis, f.theta, replace(w, moved=x.reshape(w.moved.shape)).shift) for x in z]
    flat = white(sim.residuals(runs, still))
    costs = ((flat**2).sum(-1) + (z**2).sum(-1) / KAPPA**2) / white.count
    return flat, np.where(np.isfinite(costs), costs, np.inf)
