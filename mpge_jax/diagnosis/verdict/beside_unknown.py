"""Physics that nobody named, first: what acts beside it, and whether what was named is only like it.

Where one force has no name, effects that are like it a little are found in its place, or what has a name is hidden by
it. A function of what goes on at the place, or of another joint's motion, may stand for it: then effects are searched
for beside it. Else they are searched for at the other joints while its own moves as recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.prediction_error import errors
from mpge_jax.diagnosis.evidence.held_out_error import FitReport, fit_report, judged, left_out
from mpge_jax.diagnosis.evidence.scored import Reached
from mpge_jax.diagnosis.residual.model import Function, with_functions
from mpge_jax.diagnosis.residual.motion import functions_of_motion
from mpge_jax.diagnosis.selection.confirmation import predicts_better
from mpge_jax.diagnosis.selection.procedure import (
    Decision,
    decide,
    decide_roughly,
    look,
    tested,
    what_is_left,
)
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.selection.setup import build_search
from mpge_jax.diagnosis.thresholds import ENOUGH_WINDOWS, REMAINS
from mpge_jax.diagnosis.verdict.elsewhere import elsewhere, much_is_left
from mpge_jax.diagnosis.verdict.part_of_unknown import slightly_left
from mpge_jax.diagnosis.verdict.remainder_description import describe

ROUNDS = 3
"""How often effects are searched for beside functions that were told beside the effects of before, at most."""
LIKE = "it is only like what acts: without it, a force that nobody named predicts recordings far better"


def beside_unknown(
    p: Prepared, s: Search, found: Decision, held: FitReport, say: Callable[[str], None]
) -> tuple[Decision, FitReport]:
    """What was found, with its errors on test recordings; where something is left, the effects that are found beside a
    function or elsewhere instead, if these tell more."""
    if found.left is None:
        return found, held
    here = describe(p, found.left, 1.0)["at"]
    if slightly_left(p, s, found, here):
        return found, held
    _, left = what_is_left(p, NOTHING, s)
    if left is None:
        return found, held
    at = describe(p, left, 1.0)["at"]
    anywhere = list(dict.fromkeys([*at, *here]))
    say("asking what one unknown force explains")
    instead = _beside_functions(p, s, found, at, anywhere, say) or elsewhere(p, s, found, anywhere, say)
    if instead is None:
        return found, held
    return _nothing_unknown(p, s, instead, say) or (instead, fit_report(p, instead.fit, "test"))


def _nothing_unknown(
    p: Prepared, s: Search, instead: Decision, say: Callable[[str], None]
) -> tuple[Decision, FitReport] | None:
    """What a search finds that begins once more, with what was found beside the unknown, where that leaves nothing:
    then it was no unknown but what a wrong beginning had hidden. Else None."""
    say("asking whether what has no name has one, given that")
    warnings = list(p.warnings)
    s.resume = Reached(instead.fit)
    again = look(p, s)
    if again.left is None:
        decided, held = tested(p, s, decide(p, s, say, again))
        if decided.left is None:
            return decided, held
    p.warnings[:] = warnings
    return None


def _beside_functions(
    p: Prepared, s: Search, found: Decision, at: list[str], anywhere: list[str], say: Callable[[str], None]
) -> Decision | None:
    """What is found beside a function of what goes on where something acts that has no name; None where no function
    explains far more than what was found does.

    Args:
        at: where the model as given misses. anywhere: there, and where what was found does.
    """
    functions, unknown = functions_of_motion(p, s, NOTHING, at)
    named = found.fit.hypothesis.named
    # all that has a name is given up for much more alone
    better = _far_better if named else predicts_better
    if not functions or not better(p, unknown, found.fit):
        return None
    if named:
        # and such functions may act beside it as well
        _, both = functions_of_motion(p, s, found.fit, anywhere)
        if not _far_better(p, unknown, both):
            return None
    say("looking for what acts beside it")
    (first, *further), before = functions, list(p.warnings)
    beside = _found_beside(p, s, [first], [first.term.place.name], say)
    if further and beside.leaves_much:
        # what acts at another place has a name, unless it is only like that
        say("looking for what acts beside several such forces")
        warnings, p.warnings[:] = list(p.warnings), before
        several = _found_beside(p, s, functions, at, say)
        if predicts_better(p, several.whole, beside.whole):
            beside = several
        else:
            p.warnings[:] = warnings
    fit = beside.found.fit
    noise, left = what_is_left(p, fit, s)
    p.warnings += left_out([t for t in named if t not in fit.hypothesis.terms], LIKE)
    return Decision(fit, beside.found.rivals, noise, left, s)


@dataclass(frozen=True)
class _Beside:
    """What was found beside functions, both together, and whether that leaves more than a detail."""

    found: Decision
    whole: Fitted
    leaves_much: bool


def _found_beside(
    p: Prepared, s: Search, functions: list[Function], at: list[str], say: Callable[[str], None]
) -> _Beside:
    """What is found beside functions, and these told beside that in turn until it stays: functions that were told
    without it stand for some of it, and leave the rest to others."""
    known = NOTHING
    for left in reversed(range(ROUNDS)):
        unknown = with_functions(p.ctx, NOTHING, functions)
        with_it = replace(p, sim=p.sim.beside(unknown.hypothesis, unknown.theta))
        search = build_search(with_it, say, p.config.decide_s)
        search.resume = Reached(known)
        looked = look(with_it, search)
        s.log += search.log
        search.log.clear()
        if looked.fit.hypothesis == known.hypothesis or not left:
            break
        again, _ = functions_of_motion(p, s, looked.fit, at)
        if not again:
            break
        known, functions = looked.fit, again
    found, _ = tested(with_it, search, decide_roughly(with_it, search, looked))
    s.log += search.log
    return _Beside(found, with_functions(p.ctx, found.fit, functions), much_is_left(with_it, search, found))


def _far_better(p: Prepared, new: Fitted, old: Fitted) -> bool:
    """Whether recordings that only choose are predicted better beyond doubt, and by much, where they are enough."""
    w = judged(p, "choice")
    less, more = (errors(p.sim, f, w, p.noise).rms for f in (new, old))
    return w.count >= ENOUGH_WINDOWS and less**2 < REMAINS * more**2 and predicts_better(p, new, old)
