"""What parameters are uncertain by because nobody knows the given masses and inertias exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.effects.inertia import given_inertias
from mpge_jax.diagnosis.estimation.covariance import widened
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.whitening import Whitener
from mpge_jax.diagnosis.simulation.batch_simulator import Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

ITERATIONS = 3


def beside_inexact_inertias(sim: Simulator, f: Fitted, w: Windows, white: Whitener, share: float) -> Fitted:
    """`f` with the covariance that its parameters have where every body's mass and inertia may be off.

    They are fitted once more together with a factor for each, which is 1 within a deviation of `share`. What that adds
    to a parameter's variance counts, or how far the parameter goes where that is more.
    """
    given = given_inertias(share)
    if not share or not f.theta.size or not f.cov.size or given in f.hypothesis.terms:
        return f
    ctx, parts = sim.ctx, f.hypothesis.split(sim.ctx, f.theta)
    h, null = f.hypothesis.with_term(given), {given: given.effect.null(ctx, given.place)}
    start = Fitted(h, h.gather(ctx, parts | null), h.gather(ctx, f.hypothesis.split(ctx, f.centre) | null))
    alone, free = fit(sim, [f, start], w, white, iterations=ITERATIONS)
    own = np.delete(np.arange(start.theta.size), h.slices(ctx)[h.terms.index(given)])
    more = np.maximum(np.diag(free.cov)[own] - np.diag(alone.cov), 0.0)
    moved = free.theta[own] - alone.theta
    return replace(f, cov=widened(f.cov, np.sqrt(np.maximum(more, moved**2))))
