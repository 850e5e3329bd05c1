"""The braking of a servo (its `kv`), which is damping of its joint while the servo's force is within its limits."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.actuator import reaches_limit
from mpge_jax.diagnosis.effects.base import register
from mpge_jax.diagnosis.effects.context import Context, Param, Place
from mpge_jax.diagnosis.effects.friction.damping import ViscousDamping
from mpge_jax.diagnosis.effects.friction.scales import braking_of_servos, damping_param
from mpge_jax.diagnosis.effects.native import SpecFields
from mpge_jax.diagnosis.effects.step import Array, Fields
from mpge_jax.diagnosis.machine.model import actuators_of_joint


@register
class ServoBraking(ViscousDamping):
    """The same in the servo, whose limits of force follow it: one that gives all that it can does not brake."""

    id, tier, order = "viscous_damping:servo", 2, 2
    equation = "-b v in the servo's force, before its limits"
    says = "The servo of the {at} brakes by {coefficient} more than the model says."
    says_less = "The servo of the {at} brakes by {coefficient} less than the model says."
    fields = ("actuator_biasprm",)

    def places(self, ctx: Context) -> list[Place]:
        """Joints of one servo that comes near its limits; elsewhere it is the same as the plain form."""
        return [p for p in super().places(ctx) if self._servo(ctx, p) is not None]

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (damping_param(ctx, place, low=-sum(braking_of_servos(ctx, place).values())),)

    @staticmethod
    def _servo(ctx: Context, place: Place) -> int | None:
        m, own = ctx.model, actuators_of_joint(ctx.model, place.index)
        if len(own) != 1 or m.actuator_biastype[own[0]] != mujoco.mjtBias.mjBIAS_AFFINE:
            return None
        brakes = m.actuator_biasprm[own[0], 1] != 0.0 or m.actuator_biasprm[own[0], 2] != 0.0
        return own[0] if brakes and reaches_limit(ctx, own[0]) else None

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        a = self._servo(ctx, place)
        f.add("actuator_biasprm", (a, 2), -theta[..., 0] / float(ctx.model.actuator_gear[a, 0]) ** 2)

    def export(self, spec: mujoco.MjSpec, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        self.model(SpecFields(spec), ctx, place, theta)
        return True
