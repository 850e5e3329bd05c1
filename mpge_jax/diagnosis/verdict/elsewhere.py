"""Physics that nobody named at one joint: what acts elsewhere, told while that joint moves as it was recorded.

What has no name falsifies what is told of all joints that it moves. Where their own motion is told beside the recorded
one of its joint it need not be known: they feel that joint's position, speed and acceleration, and nothing else of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.evidence.held_out_error import left_out
from mpge_jax.diagnosis.evidence.scored import clearly_worse
from mpge_jax.diagnosis.machine.model import is_scalar
from mpge_jax.diagnosis.selection.confirmation import refitted
from mpge_jax.diagnosis.selection.procedure import Decision, decide, tested, what_is_left
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.selection.setup import build_search
from mpge_jax.diagnosis.verdict.part_of_unknown import acted_on, joints_at

TRIES = 2
"""Joints, at most, at which something may act that has no name: those where most is left."""


def elsewhere(
    p: Prepared, s: Search, found: Decision, at: list[str], say: Callable[[str], None]
) -> Decision | None:
    """What was found at the one joint at which something acts that has no name, with what is found at the others while
    it moves as recorded; None where that leaves something of their motion at each joint that it may be, or tells it no
    better than what was found there before: that nothing speaks for an effect does not speak against it.

    Args:
        at: joints or actuators at which something is left, likeliest first.
    """
    if p.model.njnt < 2 or p.ctx.contacts:
        return None
    joints = dict.fromkeys(j for name in at for j in joints_at(p, name) if is_scalar(p.model, j))
    for joint in list(joints)[:TRIES]:
        name = p.names.joints[joint]
        say(f"looking for what acts elsewhere while the {name} moves as recorded")
        machine = p.guiding(int(p.model.jnt_dofadr[joint]))
        search = build_search(machine, say, p.config.decide_s)
        search.terms = [t for t in search.terms if not _only_at(p, t, joint)]
        others, _ = tested(machine, search, decide(machine, search, say))
        s.log += search.log
        if others.left is None:
            break
    else:
        return None
    terms = found.fit.hypothesis.terms
    here = Hypothesis.of(*(t for t in terms if _only_at(p, t, joint)))
    there = Hypothesis.of(*(t for t in terms if t not in here.terms))
    if not _tells_more(search, others.fit, found.fit.of_terms(p.ctx, there)):
        return None
    fit = _together(p, found.fit, here, others.fit)
    gone = [t for t in found.fit.hypothesis.named if t not in fit.hypothesis.terms]
    p.warnings[:] = machine.warnings + left_out(
        gone, f"it is only like what acts at the {name}: while that moves as recorded nothing speaks for it"
    )
    noise, left = what_is_left(p, fit, s)
    rivals = {t: r for t, r in found.rivals.items() if t in here.terms} | others.rivals
    return Decision(fit, rivals, noise, left, s)


def _tells_more(s: Search, new: Fitted, old: Fitted) -> bool:
    """Whether windows of the machine whose joint moves as recorded are better predicted by `new` beyond doubt."""
    before, after = s.score([refitted(s, old), new], s.whiten(new))
    return clearly_worse(before, after)


def _only_at(p: Prepared, term: Term, joint: int) -> bool:
    return acted_on(p.model, term.place) == [joint]


def _together(p: Prepared, found: Fitted, here: Hypothesis, others: Fitted) -> Fitted:
    """Some effects of one fit beside those of another, each as it was fitted."""
    if not here.terms:
        return others
    h, fits = Hypothesis.of(*here.terms, *others.hypothesis.terms), (found, others)

    def both(*vectors: np.ndarray) -> np.ndarray:
        each = [f.hypothesis.split(p.ctx, x) for f, x in zip(fits, vectors, strict=True)]
        return h.gather(p.ctx, each[0] | each[1])

    own, cov = dict(zip(h.terms, h.slices(p.ctx), strict=True)), np.zeros((len(h.params(p.ctx)),) * 2)
    for f in fits:
        its = [x for x in zip(f.hypothesis.terms, f.hypothesis.slices(p.ctx), strict=True) if x[0] in own]
        for a, rows in its:
            for b, columns in its:
                cov[own[a], own[b]] = f.cov[rows, columns]
    return Fitted(h, both(found.theta, others.theta), both(found.centre, others.centre), cov=cov)
