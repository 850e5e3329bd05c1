"""What parameters are uncertain by because nobody knows the given masses and inertias exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.inertia.given import given_inertias
from mpge_jax.diagnosis.estimation.covariance import widened
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.whitening import Whitener
from mpge_jax.diagnosis.simulation.batch_simulator import Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

ITERATIONS = 3


def beside_inexact_inertias(sim: Simulator, f: Fitted, w: Windows, white: Whitener, share: float) -> Fitted:
    """`f` with the covariance that its parameters have where every body's mass and inertia may be off.

    They are fitted once more together with a factor for each, which is 1 within a deviation of `share`.
    """
    start = with_free_inertias(sim.ctx, f, share)
    if start is None or not f.cov.size:
        return f
    alone, free = fit(sim, [f, start], w, white, iterations=ITERATIONS)
    return as_wide_as(sim.ctx, f, alone, free, share)


def with_free_inertias(ctx: Context, f: Fitted, share: float) -> Fitted | None:
    """`f` with a factor of one for every mass and inertia; None where they are exact, or where it has no parameters or
    has these already."""
    given = given_inertias(share)
    if not share or not f.theta.size or given in f.hypothesis.terms:
        return None
    return f.beside_nothing(ctx, given)


def as_wide_as(ctx: Context, f: Fitted, alone: Fitted, free: Fitted, share: float) -> Fitted:
    """`f` with intervals that hold what the factors leave open: what they add to a parameter's variance, or how far the
    parameter goes with them where that is more.

    Args:
        alone: `f`, fitted once more without the factors. free: with them.
    """
    h = free.hypothesis
    own = np.delete(np.arange(free.theta.size), h.slices(ctx)[h.terms.index(given_inertias(share))])
    more = np.maximum(np.diag(free.cov)[own] - np.diag(alone.cov), 0.0)
    moved = free.theta[own] - alone.theta
    return replace(f, cov=widened(f.cov, np.sqrt(np.maximum(more, moved**2))))
