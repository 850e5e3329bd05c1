"""The last of a fit through impacts: a search without slopes, and deviations that do not rest on them.

Where feet strike and slip, or motors the ends of a gap, the loss is rugged: over the step of a finite difference a
single impact may come or go, and its slope says nothing of where the optimum lies, and holds all the information that
there seems to be.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mpge_jax.diagnosis.estimation.estimate import Fitted, bounds, prior_loss
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss
from mpge_jax.diagnosis.simulation.batch_simulator import Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
ROUNDS, MOST = 8, 40
"""Generations of the search, and candidates in each at most."""
GROW, SHRINK = 0.9, 0.6
"""Change of its width after generations in which several candidates were better, or none or one."""
SECANT = 20.0
"""Length of the differences of which deviations are told, in usual ones."""
SEEN = 3.0
"""Deviations, in a parameter's scales, above which the windows do not determine it; it stays."""
DRAWS, WIDER = 2, 1.5
"""Generations drawn from those candidates that are as good as the best, and how much more widely than these lie."""
EQUAL = 2.0
"""Standard errors of the paired losses up to which a candidate may be as good as the best."""


@dataclass
class _Tried:
    """All candidates so far [K, p] with their losses by window [K, W] and in all [K]."""

    theta: Array
    losses: Array
    loss: Array

    @property
    def best(self) -> int:
        return int(np.argmin(self.loss))

    def equal(self) -> Array:
        """Which candidates [K] the windows do not tell from the best."""
        worse = self.losses - self.losses[self.best]
        error = worse.std(1, ddof=1) / np.sqrt(worse.shape[1])
        return self.loss - self.loss.min() <= EQUAL * error

    def add(self, sim: Simulator, f: Fitted, theta: Array, w: Windows, white: Whitener) -> int:
        """Evaluate candidates [n, p]; returns how many of them are better than all before."""
        params = f.hypothesis.params(sim.ctx)
        found = evaluate(sim, [replace(f, theta=t) for t in theta], w, white)
        losses = np.array([robust_loss(x.x) for x in found]).reshape(len(found), w.count)
        loss = losses.mean(1) + [prior_loss(params, t, f.centre, *white.seen.shape) for t in theta]
        better = int((loss < self.loss.min(initial=np.inf)).sum())
        self.theta, self.loss = np.concatenate([self.theta, theta]), np.concatenate([self.loss, loss])
        self.losses = np.concatenate([self.losses, losses])
        return better


def polished(sim: Simulator, f: Fitted, w: Windows, white: Whitener, seed: int) -> Fitted:
    """`f`, or better parameters near it, on windows `w`: a (1 + n) evolution strategy from the parameters' scales down,
    then draws along what the windows do not tell from the best.

    Its covariance holds how far these lie apart, and the width at which the search ended.
    """
    rng, params = np.random.default_rng([seed, 19, f.theta.size]), f.hypothesis.params(sim.ctx)
    f = fit(sim, [f], w, white, iterations=0, stride=SECANT)[0]
    scales = np.array([p.scale for p in params])
    low, high = bounds(params)
    width = np.where(np.sqrt(np.diag(f.cov)) < SEEN * scales, scales, 0.0)
    if not width.any() or w.count < 2:
        return f
    count = min(4 + 4 * int(np.count_nonzero(width)), MOST)
    tried = _Tried(np.zeros((0, width.size)), np.zeros((0, w.count)), np.zeros(0))
    tried.add(sim, f, f.theta[None], w, white)
    for _ in range(ROUNDS):
        theta = tried.theta[tried.best] + width * rng.standard_normal((count, width.size))
        better = tried.add(sim, f, np.clip(theta, low, high), w, white)
        width = width * (GROW if better > 1 else SHRINK)
    for _ in range(DRAWS):
        equal = tried.theta[tried.equal()]
        root = WIDER * (equal - equal.mean(0)) / np.sqrt(max(len(equal) - 1, 1))
        theta = tried.theta[tried.best] + rng.standard_normal((2 * count, len(equal))) @ root
        theta = theta + width * rng.standard_normal(theta.shape)
        tried.add(sim, f, np.clip(theta, low, high), w, white)
    best = fit(sim, [replace(f, theta=tried.theta[tried.best])], w, white, iterations=0, stride=SECANT)[0]
    # so few candidates do not reach the rim of what is as good: their extent is taken for one deviation
    spread = np.hypot(np.abs(tried.theta[tried.equal()] - best.theta).max(0), width)
    deviation = np.sqrt(np.maximum(np.diag(best.cov), 1e-300))
    wider = np.maximum(spread / deviation, 1.0)
    return replace(best, cov=best.cov * wider[:, None] * wider[None, :])
