"""What is left of a driven machine's motion, as functions fitted through simulated windows."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual import Residual, residual_of
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.prediction_error import errors
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.residual.formula import formula
from mpge_jax.diagnosis.residual.inputs import functions, places_of, seen
from mpge_jax.diagnosis.residual.model import Function, ResidualModel, with_function, worthwhile
from mpge_jax.diagnosis.residual.regression import Blocks, Candidate, Choice, best_of, smoothed
from mpge_jax.diagnosis.residual.roll_out import stays
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
WINDOWS, FOLDS = 100, 5
"""Windows, at most, that a function is fitted to, and the stretches of them that are predicted from the others."""
PROBE = 0.02
"""Force, in the machine's typical ones, by which the windows' answers to a function's values are told."""
STEPS, PASSES = 4, 3
"""Steps of Gauss and Newton, at most; and how often inputs are chosen and these steps taken: at first with noise
enlarged by all that is missing, then by what the last choice leaves."""
SHORTER, SLOW = (1.0, 0.5, 0.2), 0.02
"""Parts of a step that are tried, and share by which it must lower the loss for another one."""


def residual_of_motion(
    p: Prepared, s: Search, f: Fitted, at: list[str], held: FitReport
) -> ResidualModel | None:
    """The force that `f` lacks at some places as functions of what goes on there; None where none makes unseen
    recordings better predicted.

    Windows of all but the test recordings fit a function; its inputs and its smoothness are those with which stretches
    of them are best predicted from the others.

    Args:
        at: joints or actuators at which something is left. held: errors of `f` on test recordings.
    """
    places, fitted = places_of(p, at), f
    found: list[Function] = []
    w = p.all_to_train().windows("train", p.config.decide_s, WINDOWS, seed=17)
    while places and w.count:
        function = _function(p, s, fitted, places, w)
        if function is None:
            break
        now = with_function(p.ctx, fitted, function.term, function.theta)
        if not stays(p, now, fitted):
            break
        fitted = now
        found.append(function)
        places = [place for place in places if place != function.term.place]
    after = errors(p.sim, fitted, held.windows, p.noise).rms
    return worthwhile(found, held.after.rms, after)


def _function(p: Prepared, s: Search, f: Fitted, places: list[Place], w: Windows) -> Function | None:
    """The function at one of the places that explains most of what `f` leaves."""
    fold = np.arange(w.count) * FOLDS // w.count
    known = {place: seen(p, place) for place in places}
    candidates = [(e, x) for x in places for e in functions(known[x])]
    longer = p.all_to_train().windows("train", p.config.report_s, WINDOWS, seed=18)
    now, term, theta, tried = f, None, np.zeros(0), []
    for _ in range(PASSES):
        white = s.whiten_one(now, w)
        weight = _weight(white, white(p.sim.residuals([Run(now.hypothesis, now.theta)], w)[0]))

        def problem(
            effect: Residual, place: Place, white: Whitener = white, weight: Array = weight
        ) -> Candidate:
            empty = with_function(p.ctx, f, Term(effect.id, place))
            return effect, place.index, _blocks(p, empty, f, w, white, weight)

        best = best_of(candidates, problem, fold)
        if best is None:
            break
        chosen = Term(best.effect.id, next(x for x in places if x.index == best.place))
        theta = _refined(p, f, chosen, best, w, white, fold, theta if chosen == term else None)
        term, now = chosen, with_function(p.ctx, f, chosen, theta)
        tried.append((errors(p.sim, now, longer, p.noise).rms, term, theta))
    if not tried:
        return None
    # in units of the noise alone, windows that a function cannot follow count ever less
    _, term, theta = min(tried, key=lambda t: t[0])
    return Function(term, theta, formula(residual_of(term.id), theta, known[term.place], term, p.ctx))


def _weight(white: Whitener, residual: Array) -> Array:
    """Weights [B] of windows with whitened residuals [B, M]: what is odd counts little."""
    return np.asarray(1.0 / (1.0 + white.excess(residual) / 5.0))


def _blocks(
    p: Prepared, f: Fitted, known: Fitted, w: Windows, white: Whitener, weight: Array | None = None
) -> Blocks:
    """The windows' least-squares problem of changes of the function that `f` has and `known` lacks.

    Args:
        weight: [B] of the windows; by what `f` leaves, if not given.
    """
    (term,) = set(f.hypothesis.terms) - set(known.hypothesis.terms)
    part = f.hypothesis.slices(p.ctx)[f.hypothesis.terms.index(term)]
    step = PROBE * max(float(p.ctx.torque[p.ctx.dof(term.place)]), 1e-9)
    runs = [Run(f.hypothesis, f.theta)]
    for k in range(part.start, part.stop):
        theta = f.theta.copy()
        theta[k] += step
        runs.append(Run(f.hypothesis, theta))
    base, *moved = white(p.sim.residuals(runs, w))
    columns = (np.array(moved) - base) / step
    return Blocks.of(columns, base, _weight(white, base) if weight is None else weight)


def _refined(
    p: Prepared,
    f: Fitted,
    term: Term,
    found: Choice,
    w: Windows,
    white: Whitener,
    fold: Array,
    start: Array | None,
) -> Array:
    """The function's values where the simulation itself is best under the penalty, from `start` or from nothing on."""

    def loss(theta: Array) -> float:
        g = with_function(p.ctx, f, term, theta)
        x = white.excess(white(p.sim.residuals([Run(g.hypothesis, g.theta)], w)[0]))
        return float(robust_loss(x).mean())

    theta = np.zeros(found.values.size) if start is None else start
    best, aim = loss(theta), found.values
    for k in range(STEPS):
        if k or start is not None:
            near = _blocks(p, with_function(p.ctx, f, term, theta), f, w, white).told_at(theta)
            aim = smoothed(found.effect, found.place, near, fold).values
        tried = [(loss(theta + x * (aim - theta)), x) for x in SHORTER]
        least, x = min(tried)
        if least >= best:
            break
        theta = theta + x * (aim - theta)
        if least > (1.0 - SLOW) * best:
            break
        best = least
    return theta
