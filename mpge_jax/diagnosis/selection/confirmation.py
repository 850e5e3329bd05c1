"""Effects that the search found, put before recordings that it did not fit: who does not help them goes."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.missing_force import missing
from mpge_jax.diagnosis.estimation.prediction_error import Errors, errors, noise_floor
from mpge_jax.diagnosis.estimation.whitening import robust_loss
from mpge_jax.diagnosis.evidence.held_out_error import (
    BY_CHANCE,
    WINDOWS,
    FitReport,
    errors_without,
    fit_report,
    judged,
    left_out,
)
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt, by_scatter
from mpge_jax.diagnosis.evidence.null_distribution import force_noise
from mpge_jax.diagnosis.evidence.numerics_seen import amounts_seen
from mpge_jax.diagnosis.recordings.three_parts import Part
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.windows import Windows
from mpge_jax.diagnosis.thresholds import ENOUGH_WINDOWS, LARGER, MEANS_SOMETHING, SURELY, USUALLY

Array = np.ndarray
ITERATIONS = 4
SHORT = 0.12
"""Length (s) of the windows in each of which one force is told."""
NOT_SHOWN = "some recordings speak for it, but those that are to confirm it move alike with it and without it"
ADDS = "with it the machine would need more force than without it to move as it did"


def confirmed(p: Prepared, s: Search, f: Fitted, part: Part) -> tuple[Fitted, FitReport, list[Term]]:
    """The fit without the effects that one part's recordings speak against or do not need; with its errors there, and
    those effects, of which warnings tell."""
    f, adding = _without_what_adds(p, s, f, part)
    f, needless, report = _needed(p, s, f, part)
    while needless:
        # what is left is another fit, and may add now
        f, more = _without_what_adds(p, s, f, part)
        if not more:
            break
        f, gone, report = _needed(p, s, f, part)
        adding, needless = adding + more, needless | gone
    p.warnings += left_out(adding, ADDS)
    for why in dict.fromkeys(needless.values()):
        p.warnings += left_out([t for t, its in needless.items() if its == why], why)
    return f, fit_report(p, f, part) if report.amounts else report, [*adding, *needless]


def _needed(p: Prepared, s: Search, f: Fitted, part: Part) -> tuple[Fitted, dict[Term, str], FitReport]:
    """The fit without the effects that do not make one part's recordings better predicted, over windows of the reported
    length, beyond doubt; those effects with why they went; and the errors of that fit.

    One is taken away at a time, as others may stand in for it, and the others are fitted again. All that went together
    must not be missed either, nor may what is left predict no better than the model as given where more did: what each
    of many explains may be too slight to be sure of, and its sum is not. What never predicts better goes as a whole.
    Predictions are made with the timestep, integrator and moment of the commands that recordings show beside what was
    found: what those of the model miss would drown what slight effects explain.
    """
    gone: dict[Term, str] = {}
    amounts = amounts_seen(p, f)
    report = fit_report(p, f, part, amounts)
    best = report.after
    while f.hypothesis.terms:
        without = errors_without(p, f, report)
        sure = {t: _evidence(e, report.after, report.floors) for t, e in without.items()}
        weakest = min(sure, key=lambda t: sure[t])
        if beyond_doubt(sure[weakest]):
            break
        fewer = refitted(s, f.of_terms(p.ctx, f.hypothesis.without(weakest)))
        its = fit_report(p, fewer, part, amounts)
        if beyond_doubt(_evidence(its.after, best, report.floors)) or (_helps(report) and not _helps(its)):
            break
        idle = np.allclose(without[weakest].window, report.after.window)
        gone[weakest] = NOT_SHOWN if idle else BY_CHANCE
        f, report, best = fewer, its, min(best, its.after, key=lambda e: e.rms)
    if f.hypothesis.terms and not _helps(report):
        gone |= dict.fromkeys(f.hypothesis.terms, BY_CHANCE)
        f, report = NOTHING, fit_report(p, NOTHING, part, amounts)
    return f, gone, report


def _without_what_adds(p: Prepared, s: Search, f: Fitted, part: Part) -> tuple[Fitted, list[Term]]:
    """The fit without the effects that add to the force which is missing, and these: whatever holds a machine where it
    is, such as far too much inertia, predicts one better that would fly away without what is really there."""
    gone: list[Term] = []
    w = p.windows(part, SHORT, WINDOWS[part], seed=1)
    while f.hypothesis.named and w.count >= ENOUGH_WINDOWS:
        here = missing(p.sim, f, w, p.noise)
        if _often(np.abs(here[0]) > SURELY * here[1]) <= USUALLY:
            break
        shares = {t: _adds(p, f, t, w, here) for t in f.hypothesis.named}
        worst = max(shares, key=lambda t: shares[t])
        if shares[worst] <= USUALLY:
            break
        gone.append(worst)
        f = refitted(s, f.of_terms(p.ctx, f.hypothesis.without(worst)))
    return f, gone


def _adds(p: Prepared, f: Fitted, term: Term, w: Windows, here: tuple[Array, Array]) -> float:
    """Share of the windows in which far more force is missing with an effect than without it, and more than measurement
    leaves open, at the degree of freedom where that is so most often.

    Args:
        here: what is `missing` with it.
    """
    (left, unsure), less = here, f.of_terms(p.ctx, f.hypothesis.without(term))
    before, _ = missing(p.sim, less, w, p.noise)
    more = (np.abs(left) > SURELY * unsure) & (np.abs(left) > LARGER * np.abs(before))
    return _often(more)


def _often(windows: Array) -> float:
    """Share of windows [W, nv], at the degree of freedom where they are most."""
    return float(windows.mean(0).max())


def predicts_better(p: Prepared, new: Fitted, old: Fitted) -> bool:
    """Whether recordings that only choose are predicted better, over windows of the reported length, beyond doubt."""
    w = judged(p, "choice")
    before, after = (errors(p.sim, f, w, p.noise) for f in (old, new))
    floors = np.sqrt(noise_floor(p.sim, new, w, p.noise, force_noise(p)).window)
    return beyond_doubt(_evidence(before, after, floors))


def _helps(report: FitReport) -> bool:
    """Whether a fit predicts better than the model as given."""
    return beyond_doubt(_evidence(report.before, report.after, report.floors))


def _evidence(without: Errors, after: Errors, floors: Array) -> float:
    """Logarithm of the likelihood ratio by which windows are better predicted with what the former lack.

    A joint counts by its own usual error, so that one at which something has no name does not drown what is told at
    others, and a window by the searches' own loss: one in which something else acts is missed with and without, and has
    no more say than others, unless squared errors all together speak against these beyond doubt. Where the better ones
    show nothing but noise in any window, errors count in units of it, though few windows gain: a drive may saturate now
    and then.

    Args:
        floors: [W] errors that noise alone leaves.
    """
    each = [e.each for e in (without, after)]
    shown = np.isfinite(each[0]).any(0)
    usual = np.min([np.nanmedian(x[:, shown], axis=0) for x in each], axis=0)
    more, less = ((x[:, shown] / np.maximum(usual, 1e-150)) ** 2 for x in each)
    ratio, together = (
        by_scatter(gain) if gain.size > 1 else float(np.sign(gain.sum()) * np.inf)
        for gain in (np.nansum(x, 1) for x in (robust_loss(more) - robust_loss(less), more - less))
    )
    more, less = without.window**2, after.window**2
    least = 0.5 * float(((more - less) / np.maximum(floors**2, 1e-300)).sum())
    better = after if least > 0.0 else without
    if bool((better.window <= MEANS_SOMETHING * floors).all()) and abs(least) > abs(ratio):
        return least
    return together if beyond_doubt(-np.sign(ratio) * together) else ratio


def refitted(s: Search, f: Fitted) -> Fitted:
    """A fit of what was found, less some of it, from where that was."""
    if not f.hypothesis.terms:
        return NOTHING
    return fit(s.sim, [f], s.train, s.whiten_one(f, s.train), iterations=ITERATIONS)[0]
