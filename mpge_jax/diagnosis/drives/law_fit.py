"""The parameters of an actuator's law, fitted to its measured forces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
from scipy.optimize import least_squares

from mpge_jax.diagnosis.drives.drive_law import Data, residual
from mpge_jax.diagnosis.effects.context import Context, Param
from mpge_jax.diagnosis.estimation.estimate import Fitted

Array = np.ndarray
DELAY = "actuator_delay"
STEPS, GAIN, MOVES = (-4, -2, -1, 1, 2, 4), 1e-2, 60
"""Points of the grid by which a time is moved (a row has at most four) while that lowers the cost by this share, and
how often at most."""
ALIKE, FAR, UNCHANGED = 65, 4.0, 1e-4
"""Delays near a fitted one, within so many points of the grid, that are asked whether they change anything: the cost
by this share."""


def fit_law(model: mujoco.MjModel, ctx: Context, start: Fitted, actuator: int, d: Data) -> Fitted:
    """The law `start` with the parameters [P] that explain the forces of `d.train` best, and their covariance."""
    problem = _Problem(model, ctx, start, actuator, d)
    if not problem.params:
        return start
    found = _moved(problem, _solved(problem, problem.within(start.theta)))
    delays = _delays(ctx, start)
    for i in delays:
        found = _on_the_grid(problem, found, i)
    theta, cov = found.x * problem.scale, _covariance(problem, found, delays)
    for i in delays:
        first, last = _alike(problem, found, i)
        theta[i], cov[i, i] = (first + last) / 2, (last - first) ** 2 / 12
    return replace(start, theta=theta, cov=cov, loss=found.cost)


@dataclass(frozen=True)
class _Point:
    """Parameters in units of their scales, x [P]; the cost there; slopes [N, P] of the residuals near it."""

    x: Array
    cost: float
    slopes: Array


@dataclass(frozen=True)
class _Problem:
    """What one actuator's forces leave of a law, over the law's parameters in units of their scales."""

    model: mujoco.MjModel
    ctx: Context
    start: Fitted
    actuator: int
    d: Data

    @cached_property
    def params(self) -> list[Param]:
        return self.start.hypothesis.params(self.ctx)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        return np.array([p.low for p in self.params]), np.array([p.high for p in self.params])

    @cached_property
    def scale(self) -> Array:
        return np.array([p.scale for p in self.params])

    @cached_property
    def spread(self) -> float:
        """Residuals beyond this count less and less: a few of what the start leaves."""
        return 3.0 * max(float(np.median(np.abs(self.left(self.within(self.start.theta))))), 1.0)

    def within(self, theta: Array) -> Array:
        low, high = self.bounds
        margin = 1e-6 * (high - low)
        return np.clip(theta, low + margin, high - margin) / self.scale

    def left(self, x: Array) -> Array:
        law = replace(self.start, theta=x * self.scale)
        return residual(self.model, self.ctx, law, self.actuator, self.d.train, self.d)

    def cost(self, x: Array) -> float:
        return float(self.spread**2 * (np.sqrt(1.0 + (self.left(x) / self.spread) ** 2) - 1.0).sum())

    def beside(self, x: Array, i: int, further: Array) -> list[Array]:
        """Points at which the i-th parameter is larger by each of these."""
        return [self.within(x * self.scale + by * np.eye(x.size)[i]) for by in further]


def _solved(p: _Problem, x: Array) -> _Point:
    bounds = tuple(b / p.scale for b in p.bounds)
    out = least_squares(
        p.left, x, bounds=bounds, loss="soft_l1", f_scale=p.spread, max_nfev=30, diff_step=1e-3
    )
    return _Point(out.x, float(out.cost), out.jac)


def _moved(p: _Problem, at: _Point) -> _Point:
    """From there, moved in time: as long as no command of another row arrives a delay changes nothing, so that no slope
    leads on."""
    times = [i for i, param in enumerate(p.params) if param.unit == "s"]
    for _ in range(MOVES if times else 0):
        tried = [x for i in times for x in p.beside(at.x, i, p.d.dt * np.array(STEPS))]
        least, best = min((p.cost(x), k) for k, x in enumerate(tried))
        if not least < (1.0 - GAIN) * at.cost:
            break
        at = _solved(p, tried[best])
    return at


def _delays(ctx: Context, f: Fitted) -> list[int]:
    """Indices of the parameters that are delays."""
    parts = zip(f.hypothesis.terms, f.hypothesis.slices(ctx), strict=True)
    return [part.start for t, part in parts if t.name == DELAY]


def _on_the_grid(p: _Problem, at: _Point, i: int) -> _Point:
    """With a delay at a point of the grid: a command arrives or does not, and between two points it would be a mean of
    both."""
    points = at.x[i] * p.scale[i] / p.d.dt
    ends = p.d.dt * (np.array([np.floor(points), np.ceil(points)]) - points)
    cost, x = min((p.cost(x), tuple(x)) for x in p.beside(at.x, i, ends))
    return replace(at, x=np.array(x), cost=cost)


def _covariance(p: _Problem, at: _Point, delays: list[int]) -> Array:
    """[P, P], clustered by block as what is left of a drive is not white; delays have none."""
    slopes, left = at.slopes / p.scale, p.left(at.x)
    slopes[:, delays] = 0.0
    _, index = np.unique(np.concatenate([log.block for log in p.d.train]), return_inverse=True)
    scores = np.stack([np.bincount(index, column * left) for column in slopes.T], 1)
    bread = np.linalg.pinv(slopes.T @ slopes)
    return bread @ (scores.T @ scores) @ bread


def _alike(p: _Problem, at: _Point, i: int) -> tuple[float, float]:
    """The least and the largest delay near that found which change nothing, each as likely as another, s."""
    low, high = p.bounds
    found = at.x[i] * p.scale[i]
    each = found + p.d.dt * np.linspace(-FAR, FAR, ALIKE)
    each = each[(each >= low[i]) & (each <= high[i])]
    tried = zip(each, p.beside(at.x, i, each - found), strict=True)
    alike = [float(x) for x, point in tried if p.cost(point) < (1.0 + UNCHANGED) * at.cost]
    return min([found, *alike]), max([found, *alike])
