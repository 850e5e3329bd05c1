"""What is left of a driven machine's motion, as functions fitted through simulated windows."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual import Residual
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.prediction_error import errors
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.residual.formula import formula
from mpge_jax.diagnosis.residual.inputs import functions, places_of, seen
from mpge_jax.diagnosis.residual.model import Function, ResidualModel, with_function, worthwhile
from mpge_jax.diagnosis.residual.regression import Blocks, Candidate, Choice, best_of, solved
from mpge_jax.diagnosis.residual.roll_out import stays
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
WINDOWS, FOLDS = 60, 5
"""Windows, at most, that a function is fitted to, and the stretches of them that are predicted from the others."""
PROBE = 0.02
"""Force, in the machine's typical ones, by which the windows' answers to a function's values are told."""
ROUNDS = 3
"""Steps of Gauss and Newton after the first."""
SHORTER = (1.0, 0.5, 0.2)


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
    white, fold = s.whiten_one(f, w), np.arange(w.count) * FOLDS // w.count
    values = {place: seen(p, place) for place in places}

    def problem(effect: Residual, place: Place) -> Candidate:
        empty = with_function(p.ctx, f, Term(effect.id, place))
        return effect, place.index, _blocks(p, empty, f, w, white)

    best = best_of([(e, x) for x in places for e in functions(values[x])], problem, fold)
    if best is None:
        return None
    place = next(x for x in places if x.index == best.place)
    term = Term(best.effect.id, place)
    theta = _refined(p, f, term, best, w, white)
    return Function(term, theta, formula(best.effect, theta, values[place], term, p.ctx))


def _blocks(p: Prepared, f: Fitted, known: Fitted, w: Windows, white: Whitener) -> Blocks:
    """The windows' least-squares problem of the values of the function that `f` has and `known` lacks, near its own."""
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
    return Blocks.of(columns, base, 1.0 / (1.0 + white.excess(base) / 5.0))


def _refined(p: Prepared, f: Fitted, term: Term, found: Choice, w: Windows, white: Whitener) -> Array:
    """The function's values where the simulation itself is best under the penalty."""

    def loss(theta: Array) -> float:
        g = with_function(p.ctx, f, term, theta)
        x = white.excess(white(p.sim.residuals([Run(g.hypothesis, g.theta)], w)[0]))
        return float(robust_loss(x).mean())

    best, theta = np.inf, np.zeros(found.values.size)
    for k in range(1 + ROUNDS):
        change = found.values
        if k:
            now = with_function(p.ctx, f, term, theta)
            change = solved(_blocks(p, now, f, w, white), found.effect, found.strength, theta)
        tried = [(loss(theta + x * change), x) for x in SHORTER]
        least, x = min(tried)
        if least >= best:
            break
        best, theta = least, theta + x * change
    return theta
