"""Sizes at which friction begins to matter at a joint."""

from __future__ import annotations

from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit


def torque_param(ctx: Context, place: Place, name: str, low: float = 0.0) -> Param:
    t = float(ctx.torque[ctx.dof(place)])
    return Param(name, joint_unit(ctx, place, "N m", "N"), low, 50 * t, 0.1 * t)


def damping_param(ctx: Context, place: Place, name: str = "coefficient") -> Param:
    dof = ctx.dof(place)
    scale = 0.1 * float(ctx.torque[dof]) / max(float(ctx.speed[dof]), 1e-3)
    return Param(name, joint_unit(ctx, place, "N m s/rad", "N s/m"), 0.0, 500 * scale, scale)


def falling_param(ctx: Context, place: Place) -> Param:
    """The speed by which friction has fallen to what it is while sliding."""
    v = max(float(ctx.speed[ctx.dof(place)]), 1e-3)
    return Param("velocity", joint_unit(ctx, place, "rad/s", "m/s"), 0.005 * v, 3 * v, 0.1 * v)
