"""Damping and drag: friction that grows with speed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, all_places, joint_unit
from mpge_jax.diagnosis.effects.friction.scales import braking_of_servos, damping_of_model, damping_param
from mpge_jax.diagnosis.effects.native import SpecFields
from mpge_jax.diagnosis.effects.step import Array, Fields, Forces, Step

COARSE = 0.02
"""Share of its speed that damping as large as the joint's torques takes from a joint in a timestep."""


@register
class ViscousDamping(Effect):
    id, kinds = "viscous_damping", ("joint",)
    equation = "-b v"
    says = "The {at} has viscous damping of {coefficient} that the model lacks."
    says_less = "The model damps the {at} by {coefficient} too much."
    fields = ("dof_damping",)
    confused_with = ("coulomb_friction", "quadratic_drag", "back_emf")
    remedy = "move the joint at three speeds over a decade in both directions, then let it coast unpowered"

    def places(self, ctx: Context) -> list[Place]:
        """Every scalar joint: the air brakes a floating base too."""
        return all_places(ctx, "joint")

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (damping_param(ctx, place, low=-damping_of_model(ctx, place)),)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.add("dof_damping", ctx.dof(place), theta[..., 0])

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        """Of a joint that has less than none of its own, the servo brakes by as much less."""
        f, dof, servos = SpecFields(spec), ctx.dof(place), braking_of_servos(ctx, place)
        left = float(f.get("dof_damping", dof)) + float(theta[0])
        f.set("dof_damping", dof, max(left, 0.0) if servos else left)
        if servos and left < 0.0:
            most = max(servos, key=lambda a: servos[a])
            f.add("actuator_biasprm", (most, 2), -left / float(ctx.model.actuator_gear[most, 0]) ** 2)
        return True


@register
class ExplicitDamping(ViscousDamping):
    """The same integrated explicitly, as other laws of friction and a motor's back-EMF are: MuJoCo integrates a joint's
    damping implicitly, which a coarse timestep makes another motion, and those laws would win by that alone."""

    id, runtime = "viscous_damping:explicit", True

    def places(self, ctx: Context) -> list[Place]:
        """Joints whose damping a timestep may change much; none where MuJoCo is explicit itself."""
        m = ctx.model
        implicit_off = m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        euler = m.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
        if m.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 or (euler and implicit_off):
            return []
        rate = ctx.torque / np.maximum(ctx.speed * m.dof_M0, 1e-12)
        return [p for p in super().places(ctx) if rate[ctx.dof(p)] * ctx.timestep > COARSE]

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        """Damping that takes at most half of the speed in a timestep, far from where explicit steps diverge."""
        (plain,) = super().params(ctx, place)
        high = 0.5 * float(ctx.model.dof_M0[ctx.dof(place)]) / ctx.timestep
        return (replace(plain, low=max(plain.low, -high), high=high, scale=min(plain.scale, 0.1 * high)),)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        pass

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        return Forces(joint=-theta[..., 0] * s.v[..., ctx.dof(place)]), memory


@register
class QuadraticDrag(Effect):
    id, kinds, tier, runtime = "quadratic_drag", ("joint", "body"), 2, True
    equation = "-d v |v| (of a body: at its centre of mass)"
    says = "{at} is slowed by a drag of {coefficient} times the square of its speed."
    fields = ("dof_dampingpoly",)
    confused_with = ("viscous_damping",)
    remedy = "cover a wide range of speeds"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        if place.kind == "body":
            # a tenth of the machine's weight at the body's typical speed
            v = max(float(ctx.body_speed[place.index]), 1e-2)
            scale = 0.1 * ctx.weight / v**2
            return (Param("coefficient", "N s^2/m^2", 0.0, 1e3 * scale, scale),)
        dof = ctx.dof(place)
        scale = 0.1 * float(ctx.torque[dof]) / max(float(ctx.speed[dof]), 1e-2) ** 2
        unit = joint_unit(ctx, place, "N m s^2/rad^2", "N s^2/m^2")
        return (Param("coefficient", unit, 0.0, 1e3 * scale, scale),)

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        d = theta[..., 0]
        if place.kind == "body":
            v = s.body_velocity(place.index)
            speed = xp.sqrt((v * v).sum(-1) + 1e-16)
            return Forces(body=-(d * speed)[..., None] * v), memory
        v = s.v[..., ctx.dof(place)]
        return Forces(joint=-d * v * xp.abs(v)), memory

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        if place.kind == "body":
            return False
        SpecFields(spec).add("dof_dampingpoly", (ctx.dof(place), 0), theta[0])
        return True
