"""Choose the effects: forward, one at a time, and with a look at all joints at once."""

from __future__ import annotations

import time

from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.evidence.scored import Reached, Scored, clearly_worse
from mpge_jax.diagnosis.selection.all_joints import due, everywhere
from mpge_jax.diagnosis.selection.closer_forms import closer
from mpge_jax.diagnosis.selection.competition import compete
from mpge_jax.diagnosis.selection.criteria import accept, choose
from mpge_jax.diagnosis.selection.search_state import Search

REST = 2.0
"""What a last round, the weighing of alternatives and the report take, in rounds that found an effect."""


def search(s: Search) -> tuple[Fitted, list[Scored]]:
    """Forward selection; returns the fit and the last round's field."""
    current, last = s.resume.fit, list(s.resume.last)

    def keep() -> None:
        s.keep(Reached(current, tuple(last)))

    began, rounds = time.monotonic(), 0
    while s.terms and len(current.hypothesis.named) < s.max_terms:
        depth = len(current.hypothesis.terms)
        s.say(f"looking for effect {depth + 1}{_time_left(began, rounds)}")
        rounds += 1
        current = closer(s, current)
        ranked, base = compete(s, current, s.terms)
        current = base.fit
        chosen = _chosen(s, ranked, base) if ranked else None
        if chosen is not None:
            current, last = chosen.fit, ranked
            if due(s, current):
                current = _everywhere_or_one_more(s, current)
        else:
            last = last or ranked
            # what adds one effect at a time may end where several are needed at once
            wider = current if s.looked else everywhere(s, current)
            if wider is current:
                break
            current = wider
        keep()
    return current, last


def _everywhere_or_one_more(s: Search, current: Fitted) -> Fitted:
    """What all joints and drives together explain, unless one more effect explains as much: weaker drives with less
    rotor inertia and friction than the model has move as heavier masses do."""
    wider = everywhere(s, current)
    if wider is current:
        return wider
    ranked, base = compete(s, current, s.terms)
    one = _chosen(s, ranked, base) if ranked else None
    if one is None:
        return wider
    all_of_them, one = s.score([wider, one.fit], s.whiten(wider))
    if clearly_worse(one, all_of_them):
        return wider
    # beside it, all of them may explain more
    s.looked = False
    return one.fit


def _chosen(s: Search, ranked: list[Scored], base: Scored) -> Scored | None:
    """The candidate of a round that is accepted, if there is one. One that is beyond doubt does not wait for a better
    one that is not: where windows scatter widely, what moves most of them may still be doubtful. But what is no physics
    does not stand for physics that explains more."""
    without = base.fit.hypothesis
    able = [r for r in ranked if r is ranked[0] or r.fit.hypothesis.named != without.named]
    accepted = [r for r in able if accept(s, r, base)]
    chosen = choose(s, accepted or ranked, without)
    s.log.append(
        f"round {len(without.terms) + 1}: base {base.losses.mean():.3f}; "
        + "; ".join(f"{r.fit.hypothesis} {r.losses.mean():.3f}/{r.directions}" for r in ranked[:6])
        + f" -> {chosen.fit.hypothesis}{'' if accepted else ' (not accepted)'}"
    )
    return chosen if accepted else None


def _time_left(began: float, rounds: int) -> str:
    """How long all takes if no further effect is found, judged by the rounds so far."""
    if not rounds:
        return ""
    seconds = REST * (time.monotonic() - began) / rounds
    return f" (about {seconds:.0f} s to the end if there is no such effect)"
