"""Choose the effects: forward, one at a time, with a small beam at first and a look at all joints at once."""

from __future__ import annotations

import time

from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.evidence.scored import Reached, Scored, family, with_simpler
from mpge_jax.diagnosis.selection.all_joints import due, everywhere
from mpge_jax.diagnosis.selection.competition import compete
from mpge_jax.diagnosis.selection.criteria import accept, choose
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.thresholds import LEAVES_MUCH

REST = 2.0
"""What a last round, the weighing of alternatives and the report take, in rounds that found an effect."""


def search(s: Search) -> tuple[Fitted, list[Scored]]:
    """Forward selection with a small beam in the first two rounds; returns the fit and the last round's field."""
    current, last, first_round = s.resume.fit, list(s.resume.last), list(s.resume.first)

    def keep() -> None:
        s.keep(Reached(current, tuple(last), tuple(first_round)))

    began, rounds = time.monotonic(), 0
    while s.terms and len(current.hypothesis.terms) < s.max_terms:
        depth = len(current.hypothesis.terms)
        s.say(f"looking for effect {depth + 1}{_time_left(began, rounds)}")
        rounds += 1
        ranked, base = compete(s, current, s.terms)
        current = base.fit
        chosen = _chosen(s, ranked, base) if ranked else None
        if chosen is not None:
            current, last = chosen.fit, ranked
            if depth == 0:
                first_round = ranked
                alternatives = _beam(ranked, chosen)
                if chosen.losses.mean() > LEAVES_MUCH and len(alternatives) > 1:
                    current, last = _second_round(s, chosen, alternatives)
            if due(s, current):
                current = everywhere(s, current)
        else:
            last = last or ranked
            # what adds one effect at a time may end where several are needed at once
            wider = current if s.looked else everywhere(s, current)
            if wider is current:
                break
            current = wider
        keep()
    return current, last or first_round


def _chosen(s: Search, ranked: list[Scored], base: Scored) -> Scored | None:
    """The candidate of a round that is accepted, if there is one. One that is beyond doubt does not wait for a better
    one that is not: where windows scatter widely, what moves most of them may still be doubtful."""
    without = base.fit.hypothesis
    accepted = [r for r in ranked if accept(s, r, base)]
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


def _beam(ranked: list[Scored], chosen: Scored, width: int = 3) -> list[Scored]:
    """The chosen fit and the best ones of another kind or at another place."""

    out, kinds = [chosen], {family(chosen.fit.hypothesis.terms[-1])}
    for r in ranked:
        kind = family(r.fit.hypothesis.terms[-1])
        # a first effect that explains next to nothing is no start for a pair
        if kind not in kinds and len(out) < width and r.losses.mean() < 3.0 * chosen.losses.mean():
            out.append(r)
            kinds.add(kind)
    return out


def _second_round(s: Search, chosen: Scored, beam: list[Scored]) -> tuple[Fitted, list[Scored]]:
    """Second effects on top of each of the best first ones; the best pair if a pair is needed, else the first."""
    pairs: dict[Hypothesis, Fitted] = {}
    for b in beam:
        s.say(f"looking for effect 2 beside {b.fit.hypothesis}")
        sample = s.sample(b.fit, s.whiten_one(b.fit, s.train))
        screened = s.screened(b.fit, sample, [t for t in s.terms if compatible(b.fit.hypothesis, t)])
        for f in with_simpler(screened, 4):
            old = pairs.get(f.hypothesis)
            if old is None or f.loss < old.loss:
                pairs[f.hypothesis] = f
    if not pairs:
        return chosen.fit, [chosen]
    fits = sorted(pairs.values(), key=lambda f: f.loss)[:8]
    # under one whitening, so that pairs can be compared
    whites = s.whiten(fits[0])
    fits = sorted(fit(s.sim, fits, s.train, whites[0], iterations=4), key=lambda f: f.loss)[:5]
    whites = s.whiten(fits[0])
    fits = fit(s.sim, fits, s.train, whites[0], iterations=4)
    scored = s.score([*fits, chosen.fit], whites)
    ranked = sorted(scored[:-1], key=lambda r: r.losses.mean())
    winner = choose(s, ranked)
    s.log.append(
        f"pairs: single {scored[-1].losses.mean():.3f}; "
        + "; ".join(f"{r.fit.hypothesis} {r.losses.mean():.3f}/{r.directions}" for r in ranked[:5])
        + f" -> {winner.fit.hypothesis}"
    )
    if not accept(s, winner, scored[-1]):
        return chosen.fit, [chosen]
    return winner.fit, ranked
