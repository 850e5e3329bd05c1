"""Dry friction beside a constant force of the joint's drive, and dry friction that differs by direction: one motion.

While the joint turns, and where it sticks, both take c - k from what drives it forwards and c + k from what drives it
backwards (c: the dry friction, k: the constant force at the joint).
"""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.friction.dry import CREEPING
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.covariance import WITHIN
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.machine.model import actuators_of_joint

Array = np.ndarray
PLAIN, BY_DIRECTION, DAMPING, BIAS = (
    "coulomb_friction",
    "asymmetric_friction",
    "viscous_damping",
    "actuator_bias",
)


def by_direction(
    ctx: Context, terms: list[Term], f: Fitted, term: Term
) -> tuple[Fitted, tuple[Term, ...]] | None:
    """`f` with friction that differs by direction in place of dry friction and a constant force of the drive, or the
    other way round. None where it has neither.

    Args:
        terms: what may act. term: one of those effects.

    Returns:
        it, to begin a fit with, and what stands in it for these.
    """
    parts = f.hypothesis.split(ctx, f.theta)
    if term.plain == BY_DIRECTION:
        gone, told = {term}, _apart(ctx, terms, f, term)
    else:
        gone = _together(ctx, f.hypothesis, term)
        told = _as_one(ctx, {t: parts[t] for t in gone})
    without = Hypothesis.of(*(t for t in f.hypothesis.terms if t not in gone))
    able = {(t.id, t.place) for t in terms}
    if not told or not all((t.plain, t.place) in able and compatible(without, t) for t in told):
        return None
    return f.exchanged(ctx, gone, told), tuple(told)


def _together(ctx: Context, h: Hypothesis, term: Term) -> set[Term]:
    """Dry friction, the constant force of one drive of the same joint, and damping if there is any, one of which is
    `term`; empty where they are not all there."""
    for dry in (t for t in h.terms if t.plain == PLAIN):
        drives = actuators_of_joint(ctx.model, dry.place.index)
        pushing = [t for t in h.terms if t.id == BIAS and t.place.index in drives]
        damping = [t for t in h.terms if t.id == DAMPING and t.place == dry.place]
        every = {dry, *pushing, *damping}
        if len(pushing) == 1 and term in every:
            return every
    return set()


def _as_one(ctx: Context, parts: dict[Term, Array]) -> dict[Term, Array]:
    """Friction by direction that does what dry friction and a constant force do, where it resists both ways."""
    known = {t.plain: (t, x) for t, x in parts.items()}
    if not known:
        return {}
    (dry, law), (bias, constant) = known[PLAIN], known[BIAS]
    push = float(ctx.model.actuator_gear[bias.place.index, 0] * constant[0])
    viscous = float(known[DAMPING][1][0]) if DAMPING in known else 0.0
    one = Term(BY_DIRECTION + _form(dry), dry.place)
    if one.id not in REGISTRY or law[0] <= abs(push) or viscous < 0.0:
        return {}
    return {one: np.array([law[0] - push, law[0] + push, viscous, viscous, *law[1:]])}


def _apart(ctx: Context, terms: list[Term], f: Fitted, term: Term) -> dict[Term, Array]:
    """Dry friction and a constant force that do what friction by direction does, with damping where that has any."""
    part = f.hypothesis.slices(ctx)[f.hypothesis.terms.index(term)]
    law, drives = f.theta[part], actuators_of_joint(ctx.model, term.place.index)
    biases = [t for t in terms if t.id == BIAS and t.place.index in drives]
    gear = [float(ctx.model.actuator_gear[t.place.index, 0]) for t in biases]
    if len(gear) != 1 or not gear[0]:
        return {}
    forwards, backwards, *viscous = law[: len(REGISTRY[BY_DIRECTION].params(ctx, term.place))]
    own = law[2 + len(viscous) :]
    told = {
        Term(PLAIN + _form(term), term.place): np.array([0.5 * (forwards + backwards), *own]),
        biases[0]: np.array([0.5 * (backwards - forwards) / gear[0]]),
    }
    damping, variance = np.mean(viscous), f.cov[part, part][2 : 2 + len(viscous), 2 : 2 + len(viscous)].mean()
    if damping > WITHIN * np.sqrt(variance):
        told[Term(DAMPING, term.place)] = np.array([damping])
    return told


def _form(t: Term) -> str:
    """How the identifier of its form ends; that of friction that creeps has no other law."""
    return "" if t.id == CREEPING else t.id[len(t.plain) :]
