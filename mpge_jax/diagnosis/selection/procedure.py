"""Which effects are reported: search, weigh, refine, and keep only what helps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.evolution_strategy import polished
from mpge_jax.diagnosis.estimation.inexact_inertias import beside_inexact_inertias
from mpge_jax.diagnosis.estimation.levenberg_marquardt import as_wide_as_recordings_differ
from mpge_jax.diagnosis.estimation.whitening import Whitener
from mpge_jax.diagnosis.evidence.held_out_error import (
    MAY_BE_NONE,
    FitReport,
    fit_report,
    left_at_joints,
    left_out,
)
from mpge_jax.diagnosis.evidence.null_distribution import Floor, floor
from mpge_jax.diagnosis.evidence.numerics_seen import amounts_seen
from mpge_jax.diagnosis.evidence.scored import Reached, Rival, Scored
from mpge_jax.diagnosis.recordings.three_parts import Part
from mpge_jax.diagnosis.selection.alternatives import better_rival, find_rivals, unaffected
from mpge_jax.diagnosis.selection.backward_elimination import (
    as_wide_as_integrators_differ,
    needed_fit,
    refined,
    with_timestep_error,
    without_open_components,
)
from mpge_jax.diagnosis.selection.confirmation import confirmed, predicts_better, refitted
from mpge_jax.diagnosis.selection.criteria import may_be_none
from mpge_jax.diagnosis.selection.forward_selection import search
from mpge_jax.diagnosis.selection.remainder import Remainder, leaves, remainder
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.selection.setup import build_search
from mpge_jax.diagnosis.simulation.windows import Windows
from mpge_jax.diagnosis.thresholds import ENOUGH_WINDOWS, EXCHANGES, REMAINS, SLIGHT

REFINED = 60
"""Windows of the reported length, at most, from which parameters are refined in the end."""


@dataclass(frozen=True)
class Look:
    """What a search finds, before alternatives to that are weighed.

    Attributes:
        noise, left: as in a `Decision`; None where things strike each other, as parameters are told well only in the
            end there. whites: of training and held-out windows. last: the search's last field.
    """

    fit: Fitted
    noise: Floor | None
    left: Remainder | None
    whites: tuple[Whitener, Whitener]
    last: list[Scored]

    @property
    def steady(self) -> bool:
        """Whether the recordings may be read by it."""
        return self.noise is not None


@dataclass(frozen=True)
class Decision:
    """Effects with rivals by term, the noise's floor and what is left.

    Attributes:
        search: the one in the longest windows that were looked at.
    """

    fit: Fitted
    rivals: dict[Term, list[Rival]]
    noise: Floor
    left: Remainder | None
    search: Search

    steady: ClassVar[bool] = True

    def confirms(self, looked: Look) -> bool:
        """Whether the search had found the same."""
        same = self.fit.hypothesis == looked.fit.hypothesis
        return looked.steady and same and (self.left is None) == (looked.left is None)


Found = Look | Decision


def look(p: Prepared, s: Search) -> Look:
    """Search, and leave out what is not needed."""
    f, last = search(s)
    f, whites = needed_fit(s, f)
    noise, left = (None, None) if s.sim.rugged(f.hypothesis) else what_is_left(p, f, s)
    return Look(f, noise, left, whites, last)


def go_on(s: Search, before: Search, f: Fitted) -> None:
    """Have a search begin with what one found in the same recordings as they were read before. All joints are looked at
    together once more only where much of what was left goes away with the other reading."""
    s.log, s.resume = before.log, Reached(f)
    if before.looked:
        s.looked = _usual(s, f) > REMAINS * _usual(before, f)


def decide(p: Prepared, s: Search, say: Callable[[str], None], looked: Look) -> Decision:
    """Weigh alternatives to what a search found, go on in longer windows where that is nothing or leaves something,
    keep what recordings that chose nothing of the fit are predicted better with, and refine that on all that may be
    looked at."""
    found = _with_alternatives(p, s, looked)
    f, rivals, left, longest, length = found.fit, found.rivals, found.left, s, p.config.report_s
    if left is None and f.hypothesis.terms:
        left, length = _left_of_longer_windows(p, s, f, say)
    if left is not None or not f.hypothesis.terms:
        reached = f
        f, rivals, longest = _on_longer_windows(p, s, f, rivals, length, say)
        if f is not reached or left is None:
            # what is too slight to show in the shorter windows, and what nobody can name, may show in these
            noise, left = what_is_left(p, f, s, longest)
            found = Decision(f, rivals, noise, left, longest)
    found, _ = _kept(p, s, replace(found, left=left, search=longest), "choice")
    return _refined(p, s, found)


def decide_roughly(p: Prepared, s: Search, looked: Look) -> Decision:
    """As `decide`, but longer windows are not searched: beside what nobody can name, what is slight says little."""
    found, _ = _kept(p, s, _with_alternatives(p, s, looked), "choice")
    return _refined(p, s, found)


def _with_alternatives(p: Prepared, s: Search, looked: Look) -> Decision:
    """What a search found, after alternatives to it are weighed."""
    f, rivals = _weighed(s, looked.fit, looked.whites, looked.last)
    noise, left = looked.noise, looked.left
    if noise is None or f is not looked.fit:
        noise, left = what_is_left(p, f, s)
    return Decision(f, rivals, noise, left, s)


def _refined(p: Prepared, s: Search, found: Decision) -> Decision:
    """What was found, with parameters that longer windows tell: not where something is left, which adds up in these and
    pulls parameters along, nor through impacts."""
    c, f = p.config, found.fit
    if not f.theta.size or found.left is not None or c.report_s <= c.decide_s or s.sim.rugged(f.hypothesis):
        return found
    s.say("refining parameters")
    return replace(found, fit=refined(s, f, _longer(p)))


def tested(p: Prepared, s: Search, found: Decision) -> tuple[Decision, FitReport]:
    """What was found, without what the test recordings are predicted no better with, and without effects of which the
    interval that is reported holds that there is none, where nothing is left without them; and the errors there."""
    while True:
        found, report = _kept(p, s, found, "test")
        sure = replace(found, fit=_with_honest_intervals(p, s, found))
        unsure = may_be_none(s, sure.fit)
        if not unsure or found.left is not None:
            break
        f = found.fit.of_terms(p.ctx, found.fit.hypothesis.without(unsure[0]))
        fewer = with_fewer(p, s, found, refitted(s, f))
        if fewer.left is not None:
            break
        p.warnings += left_out(unsure[:1], MAY_BE_NONE)
        found = _refined(p, s, fewer)
    wide = as_wide_as_integrators_differ(s, sure.fit, _told_by(p, s, found))
    f = without_open_components(s, wide)
    return replace(sure, fit=f), report if f is wide else fit_report(p, f, "test")


def _kept(p: Prepared, s: Search, found: Decision, part: Part) -> tuple[Decision, FitReport]:
    """What was found, as far as one part's recordings confirm it; and the errors there."""
    f, report, gone = confirmed(p, s, found.fit, part)
    if not gone:
        return found, report
    return with_fewer(p, s, found, f), report


def with_fewer(p: Prepared, s: Search, found: Decision, f: Fitted) -> Decision:
    """What was found, with a fit of fewer effects; what ties with one of these goes without the others too."""
    kept = set(f.hypothesis.terms)
    gone = set(found.fit.hypothesis.terms) - kept
    rivals = {t: [_without(s, r, gone) for r in its] for t, its in found.rivals.items() if t in kept}
    noise, left = what_is_left(p, f, s, found.search)
    return Decision(f, rivals, noise, left, found.search)


def _without(s: Search, rival: Rival, gone: set[Term]) -> Rival:
    terms = rival.fit.hypothesis.terms
    if not rival.tied or not gone.intersection(terms):
        return rival
    fewer = rival.fit.of_terms(s.sim.ctx, Hypothesis.of(*(t for t in terms if t not in gone)))
    return replace(rival, fit=refitted(s, fewer))


def _with_honest_intervals(p: Prepared, s: Search, found: Decision) -> Fitted:
    """The fit with intervals that hold what recordings say otherwise, and what masses and inertias leave open, told by
    the windows by which its parameters were."""
    f = found.fit
    if not f.theta.size or s.sim.rugged(f.hypothesis):
        return f
    w = _told_by(p, s, found)
    white = s.whiten_one(f, w)
    f = as_wide_as_recordings_differ(s.sim, f, w, white)
    return beside_inexact_inertias(s.sim, f, w, white, p.config.masses_within)


def _told_by(p: Prepared, s: Search, found: Decision) -> Windows:
    """The windows that told the parameters of what was found."""
    return s.train if found.left is not None else _longer(p)


def _longer(p: Prepared) -> Windows:
    """Windows of the reported length, of all that may be looked at."""
    return p.all_to_train().windows("train", p.config.report_s, REFINED)


def what_is_left(p: Prepared, f: Fitted, *searches: Search) -> tuple[Floor, Remainder | None]:
    """What noise alone would leave of a search's windows if `f` were true, and what it leaves if that is more: of the
    first search where it is, or of the last."""
    for its in {id(x): x for x in searches}.values():
        noise = floor(p, f, its.length) if its.floor is None else its.floor(f)
        searches[0].log.append(f"floor {noise.loss:.3f} +- {noise.error:.3f}")
        left = remainder(its, f, noise)
        if left is not None:
            break
    return noise, left


def _left_of_longer_windows(
    p: Prepared, s: Search, f: Fitted, say: Callable[[str], None]
) -> tuple[Remainder | None, float]:
    """What `f` leaves of longer windows, where that is more than noise, and their length (s): what is slight adds up in
    them. Impacts do, too, whatever is missing.

    Windows of the reported length are asked; where their errors are more than noise and a slight rest, longer ones too.
    """
    reported = length = p.config.report_s
    if s.sim.rugged(f.hypothesis):
        return None, length
    stride, left, longest = s.sim.stride, None, s
    while (longer := _longer_search(p, longest, length, say)) is not None:
        longest, left = longer, what_is_left(p, f, longer)[1]
        s.log += longer.log
        if left is not None:
            break
        if length == reported and _nearly_explained(p, f):
            break
        length *= 2.0
    s.sim.stride = stride
    return left, length


def _nearly_explained(p: Prepared, f: Fitted) -> bool:
    """Whether at most a slight part of the error is left in windows of the reported length, over all and at each joint:
    what one misses may drown in what others had, or in their noise."""
    report = fit_report(p, f, "choice", amounts_seen(p, f))
    there = left_at_joints(p, report, range(p.model.njnt))
    return max(report.left(rugged=False) ** 2, there) <= SLIGHT


def _longer_search(p: Prepared, s: Search, length: float, say: Callable[[str], None]) -> Search | None:
    """A search in windows of a length (s); None where they are too few, or no longer than those of `s`."""
    longer = build_search(p, say, length)
    few = min(longer.train.count, longer.held.count) < ENOUGH_WINDOWS
    return None if few or longer.train.steps <= s.train.steps else longer


def _on_longer_windows(
    p: Prepared,
    s: Search,
    f: Fitted,
    rivals: dict[Term, list[Rival]],
    length: float,
    say: Callable[[str], None],
) -> tuple[Fitted, dict[Term, list[Rival]], Search]:
    """`f` with its rivals, or what a search finds that goes on from there in windows longer than those of `s`, where
    what is slight adds up and what a window's start leaves open counts less; and the search in the longest of them.

    Windows become twice as long as often as that finds more, what is left shows in them more clearly (a motion that
    cannot be predicted for so long shows less), and recordings that only choose are predicted better with it.

    Args:
        length: of the first ones (s).
    """
    longest, usual, stride = s, _usual(s, f), s.sim.stride
    while True:
        longer = _longer_search(p, longest, length, say)
        if longer is None or (f.hypothesis.terms and _usual(longer, f) <= usual):
            break
        say(f"looking on in windows of {longer.train.times.max():.2g} s")
        longer.resume, longer.looked = Reached(f), s.looked
        more, last = search(longer)
        if more.hypothesis != f.hypothesis:
            more, its = _weighed(longer, *needed_fit(longer, more), last)
        s.log += longer.log
        longest = longer
        if more.hypothesis == f.hypothesis or not more.hypothesis.terms:
            break
        if f.hypothesis.terms and not predicts_better(p, more, f):
            break
        f, rivals = more, its
        length, usual = 2.0 * length, _usual(longer, more)
    s.sim.stride = stride
    return f, rivals, longest


def _usual(s: Search, f: Fitted) -> float:
    """The loss of the usual window of a search, noise included."""
    return float(np.median(leaves(s, f).left.losses))


def _weighed(
    s: Search, f: Fitted, whites: tuple[Whitener, Whitener], last: list[Scored]
) -> tuple[Fitted, dict[Term, list[Rival]]]:
    """A final fit with its rivals, after exchanging terms for rivals that predict clearly better."""
    stands: dict[Term, list[Rival]] = {}
    for left in reversed(range(EXCHANGES + 1)):
        rivals = find_rivals(s, s.score([f], whites)[0], whites, last, weighed=stands)
        better = better_rival(rivals)
        if better is None or not left:
            break
        s.log.append(f"exchanged: {f.hypothesis} -> {better.fit.hypothesis}")
        s.resume = Reached(better.fit)
        before = f.hypothesis
        f, last = search(s)
        f, whites = needed_fit(s, f)
        stands = unaffected(s, rivals, before, f.hypothesis)
    if f.theta.size and s.sim.rugged(f.hypothesis):
        s.say("refining parameters")
        f = with_timestep_error(s, polished(s.sim, f, s.train, s.whiten(f)[0], s.seed), s.train)
    return f, rivals
