"""Sizes at which friction begins to matter at a joint."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.machine.model import is_joint_transmission


def torque_param(ctx: Context, place: Place, name: str, low: float = 0.0) -> Param:
    t = float(ctx.torque[ctx.dof(place)])
    return Param(name, joint_unit(ctx, place, "N m", "N"), low, 50 * t, 0.1 * t)


def damping_param(ctx: Context, place: Place, name: str = "coefficient") -> Param:
    dof = ctx.dof(place)
    scale = 0.1 * float(ctx.torque[dof]) / max(float(ctx.speed[dof]), 1e-3)
    return Param(name, joint_unit(ctx, place, "N m s/rad", "N s/m"), 0.0, 500 * scale, scale)


def friction_of_model(ctx: Context, place: Place) -> float:
    """The dry friction that the model has at a joint."""
    return float(ctx.model.dof_frictionloss[ctx.dof(place)])


def damping_of_model(ctx: Context, place: Place) -> float:
    """The damping that the model has at a joint, the braking of its servos included."""
    m = ctx.model
    brake = np.where(m.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE, -m.actuator_biasprm[:, 2], 0.0)
    own = [a for a in range(m.nu) if is_joint_transmission(m, a) and m.actuator_trnid[a, 0] == place.index]
    servos = sum(max(float(brake[a]), 0.0) * float(m.actuator_gear[a, 0]) ** 2 for a in own)
    return float(m.dof_damping[ctx.dof(place)]) + servos


def falling_param(ctx: Context, place: Place) -> Param:
    """The speed by which friction has fallen to what it is while sliding."""
    v = max(float(ctx.speed[ctx.dof(place)]), 1e-3)
    return Param("velocity", joint_unit(ctx, place, "rad/s", "m/s"), 0.005 * v, 3 * v, 0.1 * v)
