"""Effects that no recording of a machine can tell apart: if one explains the motion, so does the other.

Which of them it is must then not be decided by which has fewer parameters, or was tried first.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.machine.model import is_joint_transmission, scalar_joints

PARALLEL = 1e-6
"""Sine of the angle between axes up to which they are parallel."""

Same = Callable[[Context, Term, Term], bool]


def _alone(ctx: Context) -> bool:
    """Whether the machine is one joint with bearings that one actuator drives."""
    m = ctx.model
    return m.nv == m.njnt == m.nu == 1 and is_joint_transmission(m, 0)


def _one_joint_driven_by_one(ctx: Context, _a: Term, _b: Term) -> bool:
    """All that the machine does begins with the command: it comes late to whoever looks late at it, too."""
    return _alone(ctx)


def _one_scale(ctx: Context, _a: Term, _b: Term) -> bool:
    """Inertia and weight grow alike where a mass sits right, and nothing else resists the drive."""
    return _alone(ctx)


def _planar(ctx: Context, _tilt: Term, offset: Term) -> bool:
    """All axes are parallel, and the offset is that of the joint that carries everything: the whole machine turns about
    the axis about which gravity does."""
    m = ctx.model
    joints, root = scalar_joints(m), offset.place.index
    if len(joints) != m.njnt or (m.jnt_type != mujoco.mjtJoint.mjJNT_HINGE).any() or ctx.contacts:
        return False
    carried = [j for j in joints if m.body_rootid[m.jnt_bodyid[j]] == m.body_rootid[m.jnt_bodyid[root]]]
    first = m.jnt_bodyid[root] == m.body_rootid[m.jnt_bodyid[root]]
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    across = np.linalg.norm(np.cross(data.xaxis[joints], data.xaxis[root]), axis=1)
    sprung = m.jnt_stiffness[root] > 0 or m.jnt_limited[root]
    return bool(first and not sprung and len(carried) == len(joints) and (across < PARALLEL).all())


def _its_motor(ctx: Context, damping: Term, emf: Term) -> bool:
    """Back-EMF takes force in proportion to speed from the motor of that joint, as damping does from the joint."""
    m = ctx.model
    limited = m.actuator_forcelimited[emf.place.index]
    return not limited and int(m.actuator_trnid[emf.place.index, 0]) == damping.place.index


TABLE: dict[tuple[str, str], Same] = {
    ("actuator_delay", "sensor_delay"): _one_joint_driven_by_one,
    ("gravity_tilt", "encoder_offset"): _planar,
    ("viscous_damping", "back_emf"): _its_motor,
    ("payload_mass", "actuator_gain"): _one_scale,
    ("mass_scale", "actuator_gain"): _one_scale,
}
"""Pairs of effects, and where they are the same. Forces that were measured tell actuators' effects from others: where
they were, actuators' effects are no candidates beside these."""


def same(ctx: Context, a: Term, b: Term) -> bool:
    """Whether no motion under whatever commands tells two effects apart, where both explain it."""
    for first, second in ((a, b), (b, a)):
        holds = TABLE.get((first.name, second.name))
        if holds is not None and holds(ctx, first, second):
            return True
    return False
