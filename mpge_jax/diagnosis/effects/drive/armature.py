"""The inertia of a rotor, on the link's side of its gear."""

from __future__ import annotations

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.effects.step import Array, Fields


@register
class Armature(Effect):
    id, kinds = "armature", ("joint",)
    equation = "-J a"
    says = "The drive of the {at} has a rotor inertia of {inertia} that the model lacks."
    says_less = "The model has {inertia} too much rotor inertia at the {at}."
    fields, set_const = ("dof_armature",), True
    confused_with = ("payload_mass", "actuator_delay")
    remedy = "fast chirps in two poses with different link inertia"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        dof = ctx.dof(place)
        scale = 0.1 * float(ctx.torque[dof]) / max(float(ctx.acceleration[dof]), 1e-3)
        low = -float(ctx.model.dof_armature[dof])
        return (Param("inertia", joint_unit(ctx, place, "kg m^2", "kg"), low, 500 * scale, scale),)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.add("dof_armature", (ctx.dof(place),), theta[..., 0])
