"""Sizes at which friction begins to matter at a joint."""

from __future__ import annotations

import mujoco

from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.machine.model import actuators_of_joint


def torque_param(ctx: Context, place: Place, name: str, low: float = 0.0) -> Param:
    t = float(ctx.torque[ctx.dof(place)])
    return Param(name, joint_unit(ctx, place, "N m", "N"), low, 50 * t, 0.1 * t)


def damping_param(ctx: Context, place: Place, name: str = "coefficient", low: float = 0.0) -> Param:
    dof = ctx.dof(place)
    scale = 0.1 * float(ctx.torque[dof]) / max(float(ctx.speed[dof]), 1e-3)
    return Param(name, joint_unit(ctx, place, "N m s/rad", "N s/m"), low, 500 * scale, scale)


def friction_of_model(ctx: Context, place: Place) -> float:
    """The dry friction that the model has at a joint."""
    return float(ctx.model.dof_frictionloss[ctx.dof(place)])


def damping_of_model(ctx: Context, place: Place) -> float:
    """The damping that the model has at a joint, the braking of its servos included."""
    return float(ctx.model.dof_damping[ctx.dof(place)]) + sum(braking_of_servos(ctx, place).values())


def braking_of_servos(ctx: Context, place: Place) -> dict[int, float]:
    """The damping that each actuator of a joint makes whose force falls with its speed, within its limits."""
    m = ctx.model
    return {
        a: float(-m.actuator_biasprm[a, 2] * m.actuator_gear[a, 0] ** 2)
        for a in actuators_of_joint(m, place.index)
        if m.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE and m.actuator_biasprm[a, 2] < 0.0
    }


def falling_param(ctx: Context, place: Place) -> Param:
    """The speed by which friction has fallen to what it is while sliding."""
    v = max(float(ctx.speed[ctx.dof(place)]), 1e-3)
    return Param("velocity", joint_unit(ctx, place, "rad/s", "m/s"), 0.005 * v, 3 * v, 0.1 * v)
