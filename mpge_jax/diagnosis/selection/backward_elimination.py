"""After the search: terms that are not needed go, and the rest is fitted until it stands still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.drive.motors import Drive
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.covariance import WITHIN, widened
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import (
    fit,
    gauss_newton_shift,
    slopes_of,
    timing_error,
)
from mpge_jax.diagnosis.estimation.screening import ELABORATE
from mpge_jax.diagnosis.estimation.whitening import (
    INTEGRATOR,
    LATE,
    OLDER,
    STEP,
    Whitener,
    explicit_damping,
    numerics,
    whitener,
)
from mpge_jax.diagnosis.evidence.rigid_equivalence import name_nearest
from mpge_jax.diagnosis.selection.closer_forms import in_common_forms, with_plain
from mpge_jax.diagnosis.selection.criteria import missed, moves, strength
from mpge_jax.diagnosis.selection.given_masses import as_given
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.windows import Windows
from mpge_jax.diagnosis.thresholds import ELSEWHERE, NAMED, WEAKEST

Array = np.ndarray
HALF = 0.5
"""Share of a parameter's shift by another integrator that is a deviation of it."""


def needed_fit(s: Search, f: Fitted) -> tuple[Fitted, tuple[Whitener, Whitener]]:
    """The final fit of what a search found, without what is not needed and under the nearest names; and its whiteners
    of training and held-out windows."""
    f, whites = final_fit(s, in_common_forms(s, prune(s, f)))
    f = name_nearest(s.sim.ctx, f)
    given = as_given(s, f)
    return (f, whites) if given is f else final_fit(s, given)


def prune(s: Search, current: Fitted) -> Fitted:
    """Remove or simplify, one at a time, effects that are not `missed`: beside what is left, and beside the best that
    there was, as many slight losses add up."""
    best: Fitted | None = None
    while current.hypothesis.terms:
        if not _simpler(s, current):
            return current
        whites = s.whiten(current)
        current = fit(s.sim, [current], s.train, whites[0], iterations=3)[0]
        fewer = _simpler(s, current)
        if not fewer:
            return current
        slopes = slopes_of(s.sim, current, s.train, whites[0])
        smaller = fit(s.sim, fewer, s.train, whites[0], iterations=4, slopes=slopes, anew=False)
        more = [current] if best is None else [current, best]
        scored = s.score([*smaller, *more], whites)
        weakest = min(scored[: len(smaller)], key=lambda r: r.losses.mean())
        # what was once accepted needs less to stay
        if any(missed(r, weakest) and moves(s, r.fit, weakest.fit) for r in scored[len(smaller) :]):
            return current
        best = min(scored[len(smaller) :], key=lambda r: r.losses.mean()).fit
        s.log.append(f"removed: {current.hypothesis} -> {weakest.fit.hypothesis}")
        current = weakest.fit
    return current


def _simpler(s: Search, current: Fitted) -> list[Fitted]:
    """The hypothesis without each of several terms, and with a plainer form of each that has one.

    What several other joints have too is likely here: it stays where it differs clearly from nothing, as each joint by
    itself may show as little as what passes for it in all of them (commands that act later, for rotor inertia).
    """
    ctx = s.sim.ctx
    deviations = strength(s, current)
    likely = {t for t in deviations if elsewhere(current, t) >= ELSEWHERE and deviations[t] >= NAMED}
    weakest = sorted(deviations, key=lambda t: (t in likely, deviations[t]))[:WEAKEST]
    parts = current.hypothesis.split(ctx, current.theta)
    centres = current.hypothesis.split(ctx, current.centre)
    out = []
    for t in (t for t in current.hypothesis.terms if t in weakest):
        h = current.hypothesis.without(t)
        if h.terms and t not in likely:
            out.append(current.of_terms(ctx, h))
        if t.id != t.plain:
            out.append(with_plain(ctx, current, [t]))
        plain = Term("coulomb_friction", t.place)
        if t.plain in ELABORATE and plain in s.terms and compatible(h, plain):
            start = {plain: np.array([max(float(parts[t][0]), plain.params(ctx)[0].scale)])}
            h = h.with_term(plain)
            out.append(Fitted(h, h.gather(ctx, {**parts, **start}), h.gather(ctx, {**centres, **start})))
    return out


def elsewhere(f: Fitted, term: Term) -> int:
    """At how many other places of its kind a fit has the same effect."""
    same = (t for t in f.hypothesis.terms if t.plain == term.plain and t.place.kind == term.place.kind)
    return sum(t != term for t in same)


def final_fit(s: Search, current: Fitted) -> tuple[Fitted, tuple[Whitener, Whitener]]:
    """Refit under the hypothesis's own whitening until it stands still."""
    for _ in range(2):
        whites = s.whiten(current)
        if not current.theta.size:
            break
        current = fit(s.sim, [current], s.train, whites[0], iterations=6, tolerance=1e-5)[0]
    whites = s.whiten(current)
    return with_timestep_error(s, current, s.train), whites


def refined(s: Search, f: Fitted, w: Windows) -> Fitted:
    """`f` with the parameters that longer windows `w` determine, and what the two kinds disagree in.

    What is wrong with a window's first state, or with the model, pulls parameters the less the longer the window is:
    the difference from the decision's windows is a bias, but for the variance by which the shorter ones know less (the
    recordings are the same). Of it the longer ones keep a part, taken as a third (it falls between the first and
    second power of the length).
    """
    if not f.theta.size or not w.count:
        return f
    shorter = fit(s.sim, [f], s.train, s.whiten_one(f, s.train), iterations=0)[0]
    longer = fit(s.sim, [f], w, s.whiten_one(f, w), iterations=6, tolerance=1e-4)[0]
    less = np.maximum(np.diag(shorter.cov) - np.diag(longer.cov), 0.0)
    bias = np.sqrt(np.maximum((longer.theta - f.theta) ** 2 - less, 0.0)) / 3.0
    longer = with_timestep_error(s, longer, w)
    return replace(longer, cov=widened(longer.cov, bias))


def with_timestep_error(s: Search, f: Fitted, w: Windows) -> Fitted:
    """Add to the covariance what the timestep may do to the parameters.

    Times carry `timing_error`. What else machines do otherwise than the model's steps (`numerics`) the fit's whitening
    sees past, and its covariance has lost what that takes away; but a motor that moves by itself within a timestep does
    so otherwise than the links, and beside one the parameters carry their shifts by each of those changes too.
    """
    if not f.theta.size or not f.cov.size:
        return f
    shift = timing_error(f.hypothesis.params(s.sim.ctx), f.theta, w.dt)
    if any(isinstance(REGISTRY[t.plain], Drive) for t in f.hypothesis.terms):
        told = numerics(s.sim, f.hypothesis, f.theta, w)
        changes = [told[what] for what in (STEP, LATE, OLDER) if what in told]
        shift = np.hypot(shift, _shifted(s, f, w, changes))
    return replace(f, cov=widened(f.cov, shift))


def as_wide_as_integrators_differ(s: Search, f: Fitted, w: Windows) -> Fitted:
    """The fit with half of what another integrator, and explicit damping, move its parameters by in its covariance.

    No machine has one, and by the model's a servo's braking adds half a step of itself to the inertia or takes it away,
    and a joint's damping adds it.
    That moves all such inertias together, so that it says nothing of whether there is one. Not where things touch: the
    model's steps are a part of its contacts.
    """
    if not f.theta.size or not f.cov.size or s.sim.rugged(f.hypothesis):
        return f
    told = numerics(s.sim, f.hypothesis, f.theta, w).get(INTEGRATOR)
    changes = [x for x in (told, explicit_damping(s.sim, f.hypothesis, f.theta, w)) if x is not None]
    return replace(f, cov=widened(f.cov, HALF * _shifted(s, f, w, changes)))


def without_open_components(s: Search, f: Fitted) -> Fitted:
    """The fit with those components of vectors at nothing of which its intervals hold that they are, unless that is
    missed: on a planar machine gravity may be tilted sideways by any angle, and to report one would say that it is
    known. Intervals stay as they are.
    """
    ctx, theta, cov = s.sim.ctx, f.theta, f.cov
    if not cov.size:
        return f
    for term, part in zip(f.hypothesis.terms, f.hypothesis.slices(ctx), strict=True):
        vector = [part.start + i for i in term.effect.vector(ctx, term.place)] if term.effect.named else []
        nothing = {part.start + i: x for i, x in enumerate(term.effect.null(ctx, term.place))}
        while len(vector) > 1:
            z = {i: abs(theta[i] - nothing[i]) / np.sqrt(max(cov[i, i], 1e-300)) for i in vector}
            least = min(vector, key=lambda i: z[i])
            if z[least] > WITHIN:
                break
            # where the others are best beside it, as near the fit the loss is quadratic
            beside = cov[:, least] / max(cov[least, least], 1e-300)
            theta, cov = theta + (nothing[least] - theta[least]) * beside, cov - np.outer(beside, cov[least])
            theta[least] = nothing[least]
            vector.remove(least)
    if np.array_equal(theta, f.theta):
        return f
    fewer = replace(f, theta=theta)
    more, less = s.score([f, fewer], s.whiten(f))
    return f if missed(more, less) else fewer


def _shifted(s: Search, f: Fitted, w: Windows, changes: list[Array]) -> Array:
    """By how much changes of the residuals [W, N, 2 nv] shift parameters [p]: by one Gauss-Newton step each, under a
    whitening that does not see past them."""
    white, out = whitener(s.sim, f.hypothesis, f.theta, w, s.noise), np.zeros(f.theta.size)
    residual = s.sim.residuals([Run(f.hypothesis, f.theta)], w)[0]
    for change in changes:
        out = np.hypot(out, gauss_newton_shift(s.sim, f, w, white, white(residual + change)))
    return out
