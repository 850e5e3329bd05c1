"""Effects that no recording of a machine can tell apart: if one explains the motion, so does the other.

Which of them it is must then not be decided by which has fewer parameters, or was tried first.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.evidence.joints_of_place import acted_on
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
    axes = _axes(m)
    across = np.linalg.norm(np.cross(axes[joints], axes[root]), axis=1)
    sprung = m.jnt_stiffness[root] > 0 or m.jnt_limited[root]
    return bool(first and not sprung and len(carried) == len(joints) and (across < PARALLEL).all())


def _its_motor(ctx: Context, damping: Term, emf: Term) -> bool:
    """Back-EMF takes force in proportion to speed from the motor of that joint, as damping does from the joint."""
    m = ctx.model
    limited = m.actuator_forcelimited[emf.place.index]
    return not limited and int(m.actuator_trnid[emf.place.index, 0]) == damping.place.index


def _along_its_slide(ctx: Context, bias: Term, force: Term) -> bool:
    """A force that keeps its direction pushes along a slide as its drive does, where slides alone carry it, the others
    across that one."""
    slide = _slide_of(ctx, bias)
    return slide is not None and _pushed_alone(ctx, slide, acted_on(ctx.model, force.place))


def _level(ctx: Context, tilt: Term, bias: Term) -> bool:
    """Gravity that leans along a slide pushes all that it carries, and nothing else, but for the little by which
    upright slides carry less: all joints are slides, the others across that one, which is level."""
    slide = _slide_of(ctx, bias)
    if slide is None or not _pushed_alone(ctx, slide, acted_on(ctx.model, tilt.place)):
        return False
    return bool(abs(_axes(ctx.model)[slide] @ _down(ctx.model)) < PARALLEL)


def _slides_alone(ctx: Context, tilt: Term, force: Term) -> bool:
    """All joints are slides, those that are not upright across each other: gravity that leans towards those that carry
    a force pushes each of these by a constant, as the force does."""
    m = ctx.model
    if (m.jnt_type != mujoco.mjtJoint.mjJNT_SLIDE).any():
        return False
    every = _axes(m)
    level = np.flatnonzero(np.linalg.norm(np.cross(every, _down(m)), axis=1) > PARALLEL)
    axes = every[level]
    across = np.abs(axes @ axes.T - np.eye(len(level))).max(initial=0.0) < PARALLEL
    return bool(across and set(level) & set(acted_on(m, force.place)))


def _slide_of(ctx: Context, drive: Term) -> int | None:
    """The slide that an actuator drives, where nothing limits its force with what is added to it."""
    m, a = ctx.model, drive.place.index
    if drive.id != drive.plain or not is_joint_transmission(m, a):
        return None
    joint = int(m.actuator_trnid[a, 0])
    limited = m.actuator_forcelimited[a] or m.jnt_actfrclimited[joint]
    return joint if m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE and not limited else None


def _pushed_alone(ctx: Context, slide: int, joints: list[int]) -> bool:
    """Whether `slide` is one of some joints, all slides, and what pushes along it moves none of the others."""
    m, others = ctx.model, [j for j in joints if j != slide]
    axes = _axes(m)
    return (
        slide in joints
        and bool((m.jnt_type[joints] == mujoco.mjtJoint.mjJNT_SLIDE).all())
        and bool((np.abs(axes[others] @ axes[slide]) < PARALLEL).all())
    )


def _down(m: mujoco.MjModel) -> np.ndarray:
    """Unit vector [3] of gravity."""
    return np.array(m.opt.gravity / np.linalg.norm(m.opt.gravity))


def _axes(m: mujoco.MjModel) -> np.ndarray:
    """Axes [njnt, 3] of the joints in the world's frame, in the model's usual pose."""
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    return np.array(data.xaxis)


TABLE: dict[tuple[str, str], Same] = {
    ("actuator_delay", "sensor_delay"): _one_joint_driven_by_one,
    ("gravity_tilt", "encoder_offset"): _planar,
    ("viscous_damping", "back_emf"): _its_motor,
    ("payload_mass", "actuator_gain"): _one_scale,
    ("mass_scale", "actuator_gain"): _one_scale,
    ("actuator_bias", "external_force"): _along_its_slide,
    ("gravity_tilt", "actuator_bias"): _level,
    ("gravity_tilt", "external_force"): _slides_alone,
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
