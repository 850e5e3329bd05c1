"""Which effects are tried where."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.closer import Closer
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.errors import InputError

EXCLUSIVE = (
    (
        "coulomb_friction",
        "stribeck_friction",
        "load_dependent_friction",
        "load_dependent_friction:gear",
        "asymmetric_friction",
        "coulomb_friction:behind_gap",
    ),
    ("viscous_damping", "viscous_damping:explicit", "viscous_damping:servo"),
    ("actuator_gain", "actuator_gain:limited", "dead_actuator"),
    ("actuator_bias", "actuator_bias:limited", "actuator_bias:reclipped"),
    ("actuator_deadzone", "actuator_deadzone:limited"),
    ("backlash", "joint_flexibility"),
)
"""Effects of which a place has at most one."""
PLAIN = ("coulomb_friction", "viscous_damping")
"""Effects that more elaborate laws of friction contain."""


def all_terms(
    ctx: Context, ids: Iterable[str] | None = None, sides: Iterable[str] | None = None
) -> list[Term]:
    """Every effect at every place where it can act.

    Raises:
        InputError: an identifier is not in the registry.
    """
    able = [i for i, effect in REGISTRY.items() if not effect.form_of]
    chosen = able if ids is None else [r for i in ids for r in able if r.partition(":")[0] == i]
    known = [i for i in REGISTRY if ":" not in i]
    unknown = [] if ids is None else [i for i in ids if i not in known]
    if unknown:
        raise InputError(f"unknown effect '{unknown[0]}'; known are {', '.join(known)}.")
    wanted = None if sides is None else set(sides)
    return [
        Term(i, place)
        for i in chosen
        if wanted is None or REGISTRY[i].side in wanted
        for place in REGISTRY[i].places(ctx)
    ]


def compatible(hypothesis: Hypothesis, term: Term) -> bool:
    """Whether a term may join a hypothesis."""
    for other in hypothesis.terms:
        if other == term:
            return False
        if other.place != term.place:
            # friction of the floor and of one geom overwrite each other
            if other.id == term.id and {other.place.kind, term.place.kind} == {"world", "geom"}:
                return False
            continue
        if any(other.plain in group and term.plain in group for group in EXCLUSIVE):
            return False
        if "dead_actuator" in (other.id, term.id) and term.place.kind == "actuator":
            return False
    return True


def closer_forms(ctx: Context, term: Term) -> list[Term]:
    """The closer forms of a plain effect that can act where it does."""
    forms = [Term(term.plain + ending, term.place) for ending in REGISTRY[term.plain].closer]
    return [form for form in forms if isinstance(form.effect, Closer) and form.effect.fits(ctx, term.place)]


def plain_form(ctx: Context, term: Term, theta: np.ndarray) -> dict[Term, np.ndarray]:
    """The plain effects that a law of friction contains, with the parameters by which they come nearest to it at theta
    [p]; none where it contains none."""
    directions = {}
    for name in PLAIN:
        nothing, one = (term.effect.containing(ctx, term.place, name, np.array([x])) for x in (0.0, 1.0))
        if len(one):
            directions[Term(name, term.place)] = (one - nothing)[0]
    if not directions:
        return {}
    sizes = np.linalg.lstsq(np.stack(list(directions.values()), 1), theta)[0]
    return {plain: size[None] for plain, size in zip(directions, sizes, strict=True)}
