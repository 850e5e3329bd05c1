"""Physics that nobody named at one joint: what acts elsewhere, told while that joint moves as it was recorded.

What has no name falsifies what is told of all joints that it moves. Where their own motion is told beside the recorded
one of its joint it need not be known: they feel that joint's position, speed and acceleration, and nothing else of it.
Joints of a loop do not: they are forced by it, noise included. Joints that it does not move are told as well already:
those of other kinematic trees move as recorded too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.evidence.held_out_error import left_out
from mpge_jax.diagnosis.evidence.joints_of_place import acted_on
from mpge_jax.diagnosis.evidence.scored import clearly_worse
from mpge_jax.diagnosis.machine.constraints import coupled
from mpge_jax.diagnosis.machine.model import is_scalar
from mpge_jax.diagnosis.selection.confirmation import refitted
from mpge_jax.diagnosis.selection.procedure import Decision, Found, decide_roughly, look, tested, what_is_left
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.selection.setup import build_search
from mpge_jax.diagnosis.verdict.part_of_unknown import joints_at, slightly_left
from mpge_jax.diagnosis.verdict.remainder_description import describe

TRIES = 2
"""Joints, at most, at which something may act that has no name: those where most is left."""


def elsewhere(
    p: Prepared, s: Search, found: Decision, at: list[str], say: Callable[[str], None]
) -> Decision | None:
    """What was found at the one joint at which something acts that has no name, with what is found at the others while
    it moves as recorded; None where that leaves more than a detail of their motion at each joint that it may be, or
    tells it no better than what was found there before: that nothing speaks for an effect does not speak against it.

    Args:
        at: joints or actuators at which something is left, likeliest first.
    """
    if p.ctx.contacts:
        return None
    together = coupled(p.model)[p.model.jnt_dofadr]
    joints = dict.fromkeys(
        j for name in at for j in joints_at(p, name) if is_scalar(p.model, j) and not together[j]
    )
    for joint in list(joints)[:TRIES]:
        held = _with_those_it_does_not_move(p.model, joint)
        if len(held) == p.model.njnt:
            continue
        name = p.names.joints[joint]
        say(f"looking for what acts elsewhere while the {name} moves as recorded")
        machine = p.guiding(*(int(p.model.jnt_dofadr[j]) for j in held))
        kept = found.fit.of_terms(p.ctx, _kept(p, found.fit.hypothesis, joint, held))
        machine = replace(machine, sim=machine.sim.beside(kept.hypothesis, kept.theta))
        search = build_search(machine, say, p.config.decide_s)
        search.terms = [
            t for t in search.terms if not _only_at(p, t, held) and t not in kept.hypothesis.terms
        ]
        others = _unless_much_is_left(machine, search, say)
        s.log += search.log
        if others is not None:
            break
    else:
        return None
    terms, here = found.fit.hypothesis.terms, kept.hypothesis
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


def _unless_much_is_left(machine: Prepared, s: Search, say: Callable[[str], None]) -> Decision | None:
    """What is found on a machine, if that leaves no more than a detail. Where it does before alternatives are weighed,
    something acts at another joint than the one that moves as recorded."""
    looked = look(machine, s)
    if much_is_left(machine, s, looked):
        return None
    found, _ = tested(machine, s, decide_roughly(machine, s, looked))
    return None if much_is_left(machine, s, found) else found


def much_is_left(machine: Prepared, s: Search, found: Found) -> bool:
    """Whether a search on a machine leaves more than a detail."""
    if found.left is None:
        return False
    return not slightly_left(machine, s, found, describe(machine, found.left, 1.0)["at"])


def _tells_more(s: Search, new: Fitted, old: Fitted) -> bool:
    """Whether windows of the machine whose joint moves as recorded are better predicted by `new` beyond doubt."""
    before, after = s.score([refitted(s, old), new], s.whiten(new))
    return clearly_worse(before, after)


def _with_those_it_does_not_move(model: mujoco.MjModel, joint: int) -> list[int]:
    """A joint and the hinges and slides of other kinematic trees, unless something couples trees."""
    if model.neq or model.ntendon:
        return [joint]
    tree = model.dof_treeid[model.jnt_dofadr]
    return [j for j in range(model.njnt) if j == joint or (tree[j] != tree[joint] and is_scalar(model, j))]


def _kept(p: Prepared, h: Hypothesis, joint: int, held: list[int]) -> Hypothesis:
    """The effects that act at held joints alone, and those that act in other trees too, which tell them as well."""
    elsewhere = set(held) - {joint}
    return Hypothesis.of(
        *(t for t in h.terms if _only_at(p, t, held) or elsewhere & set(acted_on(p.model, t.place)))
    )


def _only_at(p: Prepared, term: Term, joints: list[int]) -> bool:
    return set(acted_on(p.model, term.place)) <= set(joints)


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
