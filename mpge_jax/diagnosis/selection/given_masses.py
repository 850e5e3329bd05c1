"""Effects that say no more than that the given masses and inertias are not exact, which nobody claimed."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.candidates import plain_form
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.effects.inertia.given import MOST, GivenInertias, given_inertias
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.inexact_inertias import with_free_inertias
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.selection.criteria import missed, strength
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.thresholds import NAMED

Array = np.ndarray
ITERATIONS = 8
TOGETHER = 3
FACTOR = "mass_scale"


def as_given(s: Search, f: Fitted) -> Fitted:
    """`f` with factors of the given masses and inertias, beside the plain form of a friction, in place of every effect
    that is not `missed` then: by how far from one they would have to be, too, and beside the best that there was."""
    share = _share(s)
    if not share or not f.hypothesis.named:
        return f
    best = f
    for term in _like_masses(s, f):
        whites = s.whiten(f)
        (other,) = fit(
            s.sim, [_instead(s, f, term, given_inertias(share))], s.train, whites[0], iterations=ITERATIONS
        )
        then, *more = s.score([other, f, best], whites)
        if not any(missed(r, then) for r in more):
            s.log.append(f"as given: {f.hypothesis} -> {other.hypothesis}")
            f, best = other, min(more, key=lambda r: r.losses.mean()).fit
    return f


def with_given(s: Search, f: Fitted) -> Fitted | None:
    """`f` with factors of the given masses and inertias, to be fitted; None where they are exact, or known already."""
    return with_free_inertias(s.sim.ctx, f, _share(s))


def _share(s: Search) -> float:
    """By which share the given masses and inertias may be off; 0: not at all."""
    return next((t.effect.share for t in s.terms if isinstance(t.effect, GivenInertias)), 0.0)


def _like_masses(s: Search, f: Fitted) -> list[Term]:
    """Effects that do not differ clearly from nothing where the masses and inertias are free too; a factor of all
    masses, which is one of theirs, so that slopes cannot tell the two apart; and laws of friction that contain plainer
    ones: where a weight pulls one way, masses pass for what differs by direction."""
    ctx, free = s.sim.ctx, with_given(s, f)
    if free is not None:
        (free,) = fit(s.sim, [free], s.train, s.whiten_one(f, s.train), iterations=TOGETHER)
    size, parts, most = strength(s, free or f), f.hypothesis.split(ctx, f.theta), MOST * _share(s)

    def alike(t: Term) -> bool:
        return size[t] < NAMED or (t.id == FACTOR and abs(float(parts[t][0]) - 1.0) < most)

    return [t for t in f.hypothesis.named if alike(t) or plain_form(ctx, t, parts[t]).keys() - {t}]


def _instead(s: Search, f: Fitted, term: Term, given: Term) -> Fitted:
    """`f` without a term, or with its plain form, with factors of the given masses and inertias, to be fitted."""
    ctx = s.sim.ctx
    parts, centres = (f.hypothesis.split(ctx, x) for x in (f.theta, f.centre))
    null = given.effect.null(ctx, given.place)
    factor = np.full_like(null, parts[term][0]) if term.id == FACTOR else null
    plain = plain_form(ctx, term, parts[term])
    h = Hypothesis.of(*f.hypothesis.without(term).terms, *({given, *plain} - set(parts)))
    beside = ((factor, parts), (null, centres))
    theta, centre = (h.gather(ctx, {given: x} | plain | known) for x, known in beside)
    return Fitted(h, theta, centre)
