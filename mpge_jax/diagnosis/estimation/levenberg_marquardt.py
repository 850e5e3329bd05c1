"""Fit hypotheses to windows: Levenberg-Marquardt with all hypotheses and parameters in one batch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.effects.context import Param
from mpge_jax.diagnosis.estimation.estimate import Fitted, prior_loss, prior_widths
from mpge_jax.diagnosis.estimation.parameter_steps import Problem, beyond, proposals, without_slopes
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
LONGER, LONGEST = 10.0, 100.0
"""Growth, and the most of it, of the differences of which slopes are told in machines with contacts where no step along
them is better: over short ones a single impact may hold them fast."""


def evaluate(sim: Simulator, fits: list[Fitted], w: Windows, white: Whitener) -> list[Fitted]:
    """Losses and relative chi^2 of fits on windows."""
    res = sim.residuals([Run(f.hypothesis, f.theta) for f in fits], w)
    out = []
    for f, r in zip(fits, res, strict=True):
        x = white.excess(white(r))
        out.append(replace(f, x=x, loss=float(robust_loss(x).mean())))
    return out


def fit(
    sim: Simulator,
    starts: list[Fitted],
    w: Windows,
    white: Whitener,
    iterations: int = 8,
    tolerance: float = 1e-3,
    stride: float = 1.0,
) -> list[Fitted]:
    """Fit every start; returns them in order, with losses, information and covariances on `w`.

    Args:
        stride: length of finite differences, in usual ones.
    """
    ctx = sim.ctx
    problems = [Problem(f, f.hypothesis.params(ctx), stride=stride) for f in starts]
    _linearise(sim, problems, w, white)
    for _ in range(iterations):
        active = [p for p in problems if not p.done and p.params]
        if not active:
            break
        trials: list[tuple[Problem, Array]] = []
        for p in active:
            steps = proposals(p, ctx)
            steps += [x for t in steps[:1] for x in beyond(p, t, ctx)]
            trials += [(p, t) for t in [*steps, *without_slopes(p, ctx)]]
        best_of = {id(p): p.fit for p in active}
        for (p, t), r in zip(trials, _near(sim, trials, w), strict=True):
            found = _judged(p, t, r, w, white)
            if found.loss < best_of[id(p)].loss:
                best_of[id(p)] = found
        promising = [p for p in active if best_of[id(p)] is not p.fit]
        if sim.costly(w) and promising:
            # what cheaper steps promise is kept if it is true
            thetas = [best_of[id(p)].theta for p in promising]
            res = sim.residuals([Run(p.fit.hypothesis, t) for p, t in zip(promising, thetas, strict=True)], w)
            for p, t, r in zip(promising, thetas, res, strict=True):
                found = _judged(p, t, r, w, white)
                best_of[id(p)] = p.fit
                if found.loss < p.fit.loss:
                    best_of[id(p)], p.exact = found, r
        improved = []
        for p in active:
            best, old = best_of[id(p)], p.fit.loss
            if best is p.fit:
                p.small += 1
                p.done = p.small > 2
                if ctx.contacts and not p.done:
                    p.stride = min(LONGER * p.stride, LONGEST * stride)
                    improved.append(p)
                else:
                    p.damping *= 30
                continue
            p.fit = best
            p.damping = max(p.damping * 0.2, 1e-6)
            p.small = p.small + 1 if old - best.loss < tolerance * max(best.loss, 0.1) else 0
            p.done = p.small > 1
            improved.append(p)
        _linearise(sim, improved, w, white)
    longer = [p for p in problems if p.stride != stride]
    for p in longer:
        p.stride = stride
    _linearise(sim, longer, w, white)
    return [_finish(p) for p in problems]


def _near(sim: Simulator, trials: list[tuple[Problem, Array]], w: Windows) -> Iterator[Array]:
    """Residuals [W, N, 2 nv] of each trial, told from the point where its problem stands."""
    runs = [Run(p.fit.hypothesis, t) for p, t in trials]
    if not sim.costly(w):
        yield from sim.residuals(runs, w)
        return
    for (p, _), r in zip(trials, sim.cheaply(runs, w), strict=True):
        yield r + p.offset


def _judged(p: Problem, theta: Array, residual: Array, w: Windows, white: Whitener) -> Fitted:
    """The problem's fit at other parameters, with its loss."""
    x = white.excess(white(residual))
    loss = float(robust_loss(x).mean()) + prior_loss(p.params, theta, p.fit.centre, w.count)
    return replace(p.fit, theta=theta, loss=loss, x=x)


def _linearise(sim: Simulator, problems: list[Problem], w: Windows, white: Whitener) -> None:
    """Residuals and Jacobians [p, W, M] at the present parameters, all in one batch."""
    runs: list[Run] = []
    layout: list[tuple[int, Array]] = []
    for p in problems:
        steps = p.steps()
        layout.append((len(runs), steps))
        runs.append(Run(p.fit.hypothesis, p.fit.theta))
        for i, h in enumerate(steps):
            theta = p.fit.theta.copy()
            theta[i] += h
            runs.append(Run(p.fit.hypothesis, theta))
    if not runs:
        return
    if sim.costly(w):
        unknown = [p for p in problems if not p.exact.size]
        exact = sim.residuals([Run(p.fit.hypothesis, p.fit.theta) for p in unknown], w)
        for p, r in zip(unknown, exact, strict=True):
            p.exact = r
        res = sim.cheaply(runs, w)
        for p, (first, steps) in zip(problems, layout, strict=True):
            p.offset = p.exact - res[first]
            res[first : first + 1 + steps.size] += p.offset
    else:
        res = sim.residuals(runs, w)
    for p, (first, steps) in zip(problems, layout, strict=True):
        p.whitened = white(res[first])
        moved = white(res[first + 1 : first + 1 + steps.size])
        p.jacobian = (moved - p.whitened) / steps[:, None, None]
        x = white.excess(p.whitened)
        loss = float(robust_loss(x).mean()) + prior_loss(p.params, p.fit.theta, p.fit.centre, w.count)
        p.fit = replace(p.fit, x=x, loss=loss)


def _finish(p: Problem) -> Fitted:
    """Information, and a covariance that is robust to misfit (clustered by window)."""
    if not p.params or not p.jacobian.size:
        return replace(p.fit, information=np.zeros((0, 0)), cov=np.zeros((0, 0)))
    j, r = p.jacobian, p.whitened
    weight = 1.0 / (1.0 + p.fit.x / 5.0)
    info = np.einsum("w,pwm,qwm->pq", weight, j, j, optimize=True)
    precision = info + np.diag(1.0 / prior_widths(p.params) ** 2)
    scale = 1.0 / np.sqrt(np.diag(precision))
    inverse = np.linalg.pinv(precision * scale[:, None] * scale[None, :], hermitian=True)
    inverse = inverse * scale[:, None] * scale[None, :]
    scores = np.einsum("w,pwm,wm->wp", weight, j, r, optimize=True)
    parts = np.einsum("w,pwm,qwm->wpq", weight, j, j, optimize=True)
    plain = inverse * max(1.0, float(np.mean(weight * p.fit.x) / np.mean(weight)))
    # the larger of the two, direction by direction on the diagonal
    left_out = _jackknife(precision, parts, scores, scale)
    ratio = np.sqrt(np.maximum(left_out / np.maximum(np.diag(plain), 1e-300), 1.0))
    return replace(p.fit, information=info, cov=plain * ratio[:, None] * ratio[None, :])


def _jackknife(precision: Array, parts: Array, scores: Array, scale: Array) -> Array:
    """Variances [p] by leaving out each window in turn: unlike the sandwich of the scores [W, p], they know that a
    window which decides much (information `parts` [W, p, p]) pulls the fit towards itself.

    Args:
        scale: [p] deviations that make `precision` [p, p] a matrix of ones on the diagonal.
    """
    n = max(len(scores), 1)
    values, vectors = np.linalg.eigh(precision * scale[:, None] * scale[None, :])
    root = scale[:, None] * vectors / np.sqrt(np.maximum(values, 1e-12))
    scores = scores - parts @ (root @ (root.T @ scores.sum(0)))
    kept, axes = np.linalg.eigh(np.eye(len(scale)) - root.T @ parts @ root)
    # where one window knows all but a thousandth, the others say no more than that
    steps = np.einsum("wpk,wp->wk", axes, scores @ root) / np.maximum(kept, 1e-3)
    moves = np.einsum("wpk,wk->wp", axes, steps) @ root.T
    return (moves**2).sum(0) * (n - 1) / n


def gauss_newton_shift(sim: Simulator, f: Fitted, w: Windows, white: Whitener, moved: Array) -> Array:
    """Change of theta [p] when the whitened residuals [W, M] at `f` become `moved`, to first order."""
    p = Problem(f, f.hypothesis.params(sim.ctx))
    _linearise(sim, [p], w, white)
    weight = 1.0 / (1.0 + p.fit.x / 5.0)
    j = p.jacobian
    h = np.einsum("w,pwm,qwm->pq", weight, j, j, optimize=True)
    h = h + np.diag(1.0 / prior_widths(p.params) ** 2)
    g = np.einsum("w,pwm,wm->p", weight, j, moved - p.whitened, optimize=True)
    scale = 1.0 / np.sqrt(np.diag(h))
    return -scale * (np.linalg.pinv(h * scale[:, None] * scale[None, :], hermitian=True) @ (scale * g))


def timing_error(params: list[Param], theta: Array, timestep: float) -> Array:
    """Deviation [p] of fitted times: within a timestep nobody knows when the machine samples, filters and acts."""
    within = np.minimum(timestep / np.sqrt(12), 0.1 * np.abs(theta))
    return np.where([p.unit == "s" for p in params], within, 0.0)
