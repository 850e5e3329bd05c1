"""Where a fit goes next: damped Gauss-Newton steps inside the bounds, and points that slopes do not show."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mpge_jax.diagnosis.effects.context import Context, Param
from mpge_jax.diagnosis.estimation.estimate import Fitted, bounds, nothing, prior_loss, prior_widths
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss, robust_weight
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
FURTHER = (3.0, 8.0)
"""Lengths of the further steps that are tried in machines with contacts, in units of the proposed one."""
STEEP = 0.25
"""Quantile of the windows' slopes (squared) as which steeper ones count, there."""

PACE = 3
"""Steps that tell the pace of a fit."""


@dataclass
class Problem:
    """One hypothesis during the fit.

    Attributes:
        fit: where it stands. whitened: [W, M] residuals there. jacobian: [p, W, M] slopes of those.
        still: [p] parameters that stay, whose slopes are not asked for (zero); empty: none.
        secant: whether these hold what was seen on the way here, and were not all simulated here.
        verified: where the model's own steps told the residuals last, if cheaper ones stand for them. exact: [W, N,
        2 nv] these residuals, empty where not known yet. offset: [W, N, 2 nv] the same less those of the cheaper steps.
        exactly: whether it goes by the model's own steps, as cheaper ones led it astray.
        stride: length of finite differences, in usual ones. smooth: whether slopes tell where to go. detoured: whether
        the effects' own proposals were tried.
        losses: before each step. small: steps without a gain. last: whether the step promises no further gain after it.
        done: whether it ended.
    """

    fit: Fitted
    params: list[Param]
    still: Array = field(default_factory=lambda: np.zeros(0, bool))
    damping: float = 1e-3
    whitened: Array = field(default_factory=nothing)
    jacobian: Array = field(default_factory=nothing)
    secant: bool = False
    verified: Fitted | None = None
    exact: Array = field(default_factory=nothing)
    offset: Array = field(default_factory=nothing)
    exactly: bool = False
    stride: float = 1.0
    smooth: bool = False
    detoured: bool = False
    losses: list[float] = field(default_factory=list)
    small: int = 0
    last: bool = False
    done: bool = False

    @property
    def weight(self) -> Array:
        """[W] by how much each window counts: less, the worse it is missed."""
        return robust_weight(self.fit.x)

    @property
    def free(self) -> Array:
        """[p] whether a parameter is not to stay."""
        return ~self.still if self.still.size else np.ones(len(self.params), bool)

    def foreseen(self, theta: Array) -> Array:
        """By how much residuals [W, M] change up to `theta` [p], by the slopes."""
        return np.tensordot((theta - self.fit.theta).astype(self.jacobian.dtype), self.jacobian, 1)

    def steps(self) -> Array:
        """Finite-difference steps [p] that stay inside the bounds."""
        _, high = bounds(self.params)
        scale = np.array([p.scale for p in self.params])
        theta = self.fit.theta
        h = self.stride * (0.02 * scale + 1e-4 * np.abs(theta))
        return np.where(theta + h > high, -h, h)


def too_slow(losses: list[float], left: int, goal: float) -> bool:
    """Whether steps that are `left` do not bring a loss below a goal at the pace of the better of the last two: gains
    of a Gauss-Newton fit shrink.

    Args:
        losses: before and after each step so far.
    """
    if len(losses) <= PACE:
        return False
    pace = max(before - after for before, after in zip(losses[-3:], losses[-2:], strict=False))
    return losses[-1] - left * pace > goal


def proposals(p: Problem, ctx: Context) -> list[Array]:
    """A full and a strongly damped step, inside the bounds; with contacts, also a full one that no few windows decide.

    Through impacts slopes are steep and hold over next to nothing: windows with many would let no step be taken.
    """
    weight = p.weight
    out = [_step(p, weight, damping) for damping in (p.damping, 100 * p.damping + 0.3)]
    if ctx.contacts:
        size = np.einsum("pwm,pwm,p->w", p.jacobian, p.jacobian, prior_widths(p.params) ** 2, optimize=True)
        if (size > 0).any():
            cap = np.quantile(size[size > 0], STEEP, method="lower")
            out.append(_step(p, weight * cap / np.maximum(size, max(cap, 1e-300)), p.damping))
    return [theta for theta in out if np.isfinite(theta).all()]


def corrected(p: Problem, theta: Array, whitened: Array) -> list[Array]:
    """The proposal again, after it led to residuals [W, M] that slopes did not show: a straight step out of a bent
    valley (a mass and its place, of which only the moment is known well) is led back into it.

    Second-order correction by the residuals at the end of the step: Nocedal & Wright, Numerical Optimization, 15.6.
    """
    unseen = whitened - p.foreseen(theta)
    if not np.isfinite(unseen).all():
        return []
    found = _step(p, p.weight, p.damping, unseen)
    return [found] if np.isfinite(found).all() else []


def _step(p: Problem, weight: Array, damping: float, residuals: Array | None = None) -> Array:
    """The damped Gauss-Newton step from where `p` stands, with `weight` [W], inside the bounds: theta [p]; for other
    `residuals` [W, M] there, if told."""
    low, high = bounds(p.params)
    j, r = p.jacobian, p.whitened if residuals is None else residuals
    values = j.shape[-1]
    widths = prior_widths(p.params, values)
    h = np.einsum("w,pwm,qwm->pq", weight, j, j, optimize=True)
    g = np.einsum("w,pwm,wm->p", weight, j, r, optimize=True)
    # the loss divides by the number of compared values, so its prior counts that often
    h = h + np.diag(values / widths**2)
    g = g + values * (p.fit.theta - p.fit.centre) / widths**2
    diagonal = np.diag(h).copy()
    diagonal[diagonal <= 0] = 1e-30
    free = p.free
    step = np.zeros(len(p.params))
    while free.any():
        index = np.flatnonzero(free)
        a = h[np.ix_(index, index)] + damping * np.diag(diagonal[index])
        scale = 1.0 / np.sqrt(np.diag(a))
        down = (g + h @ np.where(free, 0.0, step))[index]
        step[index] = (
            -np.linalg.lstsq(a * scale[:, None] * scale[None, :], down * scale, rcond=1e-12)[0] * scale
        )
        there = p.fit.theta + step
        outside = free & ((there < low) | (there > high))
        if not outside.any():
            break
        # the others go where they are best with these at their bounds
        step = np.where(outside, np.clip(there, low, high) - p.fit.theta, step)
        free &= ~outside
    return np.clip(p.fit.theta + step, low, high)


def promise(p: Problem, theta: Array, w: Windows, white: Whitener) -> float:
    """The loss at `theta` if the prediction were linear."""
    moved = p.whitened + p.foreseen(theta)
    loss = float(robust_loss(white.excess(moved)).mean())
    return loss + prior_loss(p.params, theta, p.fit.centre, w.count, moved.shape[-1])


def beyond(p: Problem, theta: Array, ctx: Context) -> list[Array]:
    """Further points in the direction of a proposal, where contacts make the linear model a short-sighted one: a few
    windows with impacts have slopes so steep that they alone set the length of the step."""
    low, high = bounds(p.params)
    return [np.clip(p.fit.theta + k * (theta - p.fit.theta), low, high) for k in FURTHER if ctx.contacts]


def without_slopes(p: Problem, ctx: Context) -> list[Array]:
    """Proposals of the effects themselves, for parameters along which slopes say little."""
    low, high = bounds(p.params)
    out = []
    for term, part in zip(p.fit.hypothesis.terms, p.fit.hypothesis.slices(ctx), strict=True):
        if p.still[part].any():
            continue
        for other in term.effect.detours(ctx, term.place, p.fit.theta[part]):
            theta = p.fit.theta.copy()
            theta[part] = other
            out.append(np.clip(theta, low, high))
    return out
