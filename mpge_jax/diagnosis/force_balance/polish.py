"""Parameters as the forces give them: Gauss-Newton steps on the machine itself, and how sure they are."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted, bounds, prior_loss, prior_widths
from mpge_jax.diagnosis.force_balance.balance import Balance
from mpge_jax.diagnosis.force_balance.gram import Normal

Array = np.ndarray
STEPS = 25
"""Steps, at most."""
ENOUGH = 1e-4
"""Share of the loss below which a step is the last."""
SHORTER = (1.0, 0.3, 0.1, 0.02)


def polished(b: Balance, parts: dict[Term, Array], known: dict[Term, Array] | None = None) -> Fitted:
    """The best parameters near `parts`; their covariance allows for errors that neighbouring rows share.

    Args:
        known: columns [1, N, nu] of effects of one parameter, which change little on the way.
    """
    known = dict(known or {})
    h = Hypothesis.of(*parts)
    params = h.params(b.ctx)
    prior = prior_widths(params) ** -2.0
    low, high = bounds(params)
    theta = np.clip(h.gather(b.ctx, parts), low, high)
    centre = theta.copy()
    if not theta.size:
        return Fitted(h, theta, centre)

    def predicted(x: Array) -> Array:
        return b.predicted(h.split(b.ctx, x))

    here = predicted(theta)
    variance = _variance(b.telling - here)
    for last in range(STEPS):
        split = h.split(b.ctx, theta)
        each = {t: known[t] if t in known else b.columns(split, t, here) for t in h.terms}
        known |= {t: x for t, x in each.items() if len(x) == 1}
        columns = np.concatenate([each[t] for t in h.terms])
        normal = Normal.of(columns, b.telling - here, b.block, b.fold, prior, low - theta, high - theta)
        weighted = normal.weighted(np.where(normal.rows.sum(0) > 0, 1.0 / variance, 0.0))
        step = weighted.solve(range(len(theta)), prior * (centre - theta))
        before = _loss(b.telling - here, variance) + prior_loss(params, theta, centre, 1, 1)
        for share in SHORTER:
            trial = np.clip(theta + share * step, low, high)
            there = predicted(trial)
            after = _loss(b.telling - there, variance) + prior_loss(params, trial, centre, 1, 1)
            if after < before:
                break
        else:
            break
        theta, here, variance = trial, there, _variance(b.telling - there)
        if after > (1.0 - ENOUGH) * before and last:
            break
    every = range(len(theta))
    return Fitted(h, theta, centre, after, *weighted.spread(every, weighted.alike(every)))


def _variance(left: Array) -> Array:
    """Of each actuator's errors [nu]."""
    seen = np.isfinite(left)
    count = np.maximum(seen.sum(0), 1)
    mean = np.where(seen, left**2, 0.0).sum(0) / count
    return np.maximum(mean, 1e-12 * max(float(mean.max(initial=0.0)), 1e-300))


def _loss(left: Array, variance: Array) -> float:
    return float(np.nansum(left**2 / variance))
