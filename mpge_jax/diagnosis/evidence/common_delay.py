"""All commands late, and all encoders late by as much: the same log, as nothing tells when the machine itself moved."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.machine.model import is_joint_transmission, scalar_joints

OTHER = {"sensor_delay": "actuator_delay", "actuator_delay": "sensor_delay"}


def by_a_common_delay(
    ctx: Context, terms: list[Term], f: Fitted, term: Term
) -> tuple[Fitted, tuple[Term, ...]] | None:
    """`f` with all commands late in place of all encoders, or the other way round. None where it has neither, or not
    all of them.

    Args:
        terms: what may act. term: one of the delays.

    Returns:
        it, to begin a fit with, and what stands in it for the delays, first what does so at the joint of `term`.
    """
    m, every = ctx.model, {"sensor_delay": ctx.model.njnt, "actuator_delay": ctx.model.nu}
    gone = [t for t in f.hypothesis.named if t.id == term.id]
    if term.id not in OTHER or len(gone) != every[term.id] or len(scalar_joints(m)) != m.njnt:
        return None
    without = Hypothesis.of(*(t for t in f.hypothesis.terms if t not in gone))
    come = [t for t in terms if t.id == OTHER[term.id] and compatible(without, t)]
    if len(come) != every[OTHER[term.id]]:
        return None
    come.sort(key=lambda t: _joint(ctx, t) != _joint(ctx, term))
    parts = f.hypothesis.split(ctx, f.theta)
    delay = np.array([np.mean([parts[t][0] for t in gone])])
    return f.exchanged(ctx, gone, dict.fromkeys(come, delay)), tuple(come)


def _joint(ctx: Context, t: Term) -> int:
    """The joint at which a delay acts, -1 where it is none's alone."""
    if t.place.kind == "joint":
        return t.place.index
    a = t.place.index
    return int(ctx.model.actuator_trnid[a, 0]) if is_joint_transmission(ctx.model, a) else -1
