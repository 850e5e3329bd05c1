"""What is left of a driven machine's motion, as functions fitted through simulated windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.family import residual_of
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.missing_force import slight_forces
from mpge_jax.diagnosis.estimation.prediction_error import errors
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss, robust_weight
from mpge_jax.diagnosis.evidence.folds import folds
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.residual.formula import formula
from mpge_jax.diagnosis.residual.hints import hinted, variants
from mpge_jax.diagnosis.residual.inputs import functions, places_of, seen, turns
from mpge_jax.diagnosis.residual.model import (
    Function,
    ResidualModel,
    with_function,
    with_functions,
    worthwhile,
)
from mpge_jax.diagnosis.residual.points import pieces
from mpge_jax.diagnosis.residual.pulses import Answers, Pulses
from mpge_jax.diagnosis.residual.regression import (
    Blocks,
    Choice,
    best_function,
    fewest,
    in_the_race,
    smoothed,
    told,
)
from mpge_jax.diagnosis.residual.roll_out import staying
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.cheaper_steps import Near
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
WINDOWS = 100
"""Windows, at most, that a function is fitted to."""
STEPS, PASSES = 4, 3
"""Steps of Gauss and Newton, at most; and how often inputs are chosen and these steps taken: at first with noise
enlarged by all that is missing, then by what the last choice leaves of the usual window."""
SHORTER, SLOW = (1.0, 0.5, 0.2), 0.02
"""Parts of a step that are tried, and share by which it must lower the loss for another one."""


def residual_of_motion(
    p: Prepared, s: Search, f: Fitted, at: list[str], shown: tuple[Prepared, Fitted], held: FitReport
) -> ResidualModel | None:
    """The force that `f` lacks at some places as functions of what goes on there, told by all but the test recordings,
    as long as no joint runs away with them; None where none makes these better predicted.

    Args:
        at: joints or actuators at which something is left. shown, held: the machine and its fit whose errors on test
            recordings are reported, and these; it may be driven otherwise than the one that `f` was fitted to.
    """
    (machine, shown_fit), fits = shown, [f]
    found = functions_of_motion(p.all_to_train(), s, f, at)[0]
    for function in found:
        fits.append(with_function(p.ctx, fits[-1], function.term, function.theta))
    kept = found[: staying(p, fits)] if found else []
    shown_fit = with_functions(machine.ctx, shown_fit, kept)
    return worthwhile(kept, held.after.rms, errors(machine.sim, shown_fit, held.windows, machine.noise).rms)


def functions_of_motion(p: Prepared, s: Search, f: Fitted, at: list[str]) -> tuple[list[Function], Fitted]:
    """Functions, at most one of each place, that explain what `f` leaves of the training recordings; and `f` with them.

    Inputs and smoothness are those with which some of these recordings are best predicted from the others (`folds`).
    """
    places, fitted = places_of(p, at), f
    found: list[Function] = []
    w = p.windows("train", p.config.decide_s, WINDOWS, seed=17)
    while places and w.count:
        function = _function(p, s, fitted, places, w)
        if function is None:
            break
        fitted = with_function(p.ctx, fitted, function.term, function.theta)
        found.append(function)
        places = [place for place in places if place != function.term.place]
    return found, fitted


def _function(p: Prepared, s: Search, f: Fitted, places: list[Place], w: Windows) -> Function | None:
    """The function at one of the places that explains most of what `f` leaves."""
    fold = folds(w.recording, w.start)
    known = {place: seen(p, place) for place in places}
    candidates = [
        (e, x) for x in places for e in hinted(functions(known[x], turns(p, x)), x, pieces(p, "train", f, x))
    ]
    pulses = {x: Pulses.at(p, f, x, w) for x in places}
    longer = p.windows("train", p.config.report_s, WINDOWS, seed=18)
    now, term, theta, tried, fine = f, None, np.zeros(0), [], set[str]()
    for number in range(PASSES):
        task = _Task(p, f, w, s.whiten_one(now, w) if number else _enlarged(s, f, w), fold)
        weight = task.weight(now)
        answers = {x: pulses[x].seen_by(task.white, weight) for x in places}
        problems = [(e, x.index, answers[x].of(e)) for e, x in candidates]
        tried_now = told(problems, fold)
        best = best_function(tried_now)
        if best is None and number == 0:
            # one window that flies off is all that is left of the mean one
            continue
        if best is None:
            break
        candidates = [candidates[k] for k in in_the_race(tried_now)]
        place = next(x for x in places if x.index == best.place)
        if best.effect.id not in fine:
            finer = as_fine_as_shown(best, answers[place], fold)
            candidates = [
                (finer.effect, x) if (e, x) == (best.effect, place) else (e, x) for e, x in candidates
            ]
            best = finer
            fine.add(best.effect.id)
        chosen = Term(best.effect.id, place)
        theta = task.solved(chosen, best, theta if chosen == term else None)
        term, now = chosen, with_function(p.ctx, f, chosen, theta)
        tried.append((errors(p.sim, now, longer, p.noise).rms, term, theta))
    if not tried:
        return None
    # in units of the noise alone, windows that a function cannot follow count ever less
    _, term, theta = min(tried, key=lambda t: t[0])
    return Function(term, theta, formula(residual_of(term.id), theta, known[term.place], term, p.ctx))


def _enlarged(s: Search, f: Fitted, w: Windows) -> Whitener:
    """Whitener around a fit with noise enlarged by what it leaves of the mean window. Where something acts in few
    windows the median one shows nothing but noise, and in its units those few would count as outliers."""
    white = s.whiten_one(f, w, temper=False)
    left = white.excess(white(s.sim.residuals([Run(f.hypothesis, f.theta)], w)[0]))
    return s.whiten_one(f, w, max(float(np.sqrt(left.mean())), 1.0))


def as_fine_as_shown(found: Choice, answers: Answers, fold: Array) -> Choice:
    """The function with as many values as windows show.

    Args:
        answers: of the windows to forces at its place. fold: [B] which windows are predicted together.
    """
    return fewest([smoothed(e, found.place, answers.of(e), fold) for e in variants(found.effect)])


@dataclass(frozen=True)
class _Task:
    """What a function is fitted to.

    Attributes:
        known: effects beside which it acts. windows: B of them. white: theirs. fold: [B] which are predicted together.
    """

    p: Prepared
    known: Fitted
    windows: Windows
    white: Whitener
    fold: Array

    def solved(self, term: Term, found: Choice, start: Array | None) -> Array:
        """The function's values where the simulation itself is best under the penalty, from `start` or from nothing on.

        Args:
            found: the function told near nothing.
        """
        theta = np.zeros(found.values.size) if start is None else start
        best, aim = self._loss(term, theta), found.values
        for k in range(STEPS):
            if k or start is not None:
                aim = smoothed(found.effect, found.place, self.near(term, theta), self.fold).values
            tried = [(self._loss(term, theta + x * (aim - theta)), x) for x in SHORTER]
            least, x = min(tried)
            if least >= best:
                break
            theta = theta + x * (aim - theta)
            if least > (1.0 - SLOW) * best:
                break
            best = least
        return theta

    def near(self, term: Term, theta: Array) -> Blocks:
        """The windows' least-squares problem of a function's values, told near some values."""
        p, f = self.p, with_function(self.p.ctx, self.known, term, theta)
        part = f.hypothesis.slices(p.ctx)[f.hypothesis.terms.index(term)]
        step = float(slight_forces(p.ctx)[p.ctx.dof(term.place)])
        runs = [Run(f.hypothesis, f.theta)]
        for k in range(part.start, part.stop):
            moved = f.theta.copy()
            moved[k] += step
            runs.append(Run(f.hypothesis, moved))
        base, *probed = self.white(Near.to(p.sim, runs[0], self.windows).residuals(runs))
        return Blocks.of((np.array(probed) - base) / step, base, self._counted(base)).told_at(theta)

    def weight(self, f: Fitted) -> Array:
        """Weights [B] of the windows by what `f` leaves: what is odd counts little."""
        return self._counted(self._left(f))

    def _loss(self, term: Term, theta: Array) -> float:
        left = self._left(with_function(self.p.ctx, self.known, term, theta))
        return float(robust_loss(self.white.excess(left)).mean())

    def _left(self, f: Fitted) -> Array:
        return self.white(self.p.sim.residuals([Run(f.hypothesis, f.theta)], self.windows)[0])

    def _counted(self, left: Array) -> Array:
        return robust_weight(self.white.excess(left))
