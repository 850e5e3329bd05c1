"""What the encoders report instead of the truth."""

from __future__ import annotations

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, all_places, joint_unit
from mpge_jax.diagnosis.effects.step import Array


class _Sensor(Effect):
    kinds, side, senses = ("joint",), "sensor", True

    def places(self, ctx: Context) -> list[Place]:
        """Every scalar joint: the sensors of a floating base can be late or off as well."""
        return all_places(ctx, "joint")


@register
class EncoderOffset(_Sensor):
    id = "encoder_offset"
    equation = "measured q = q + q0"
    says = "The encoder of the {at} reads {offset} too much."
    tries = (0.0,)
    confused_with = ("com_offset",)
    remedy = "hold still in poses over the full range; compare with a mechanical stop"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        travel = max(float(ctx.travel[ctx.dof(place)]), 0.05)
        return (
            Param("offset", joint_unit(ctx, place, "rad", "m"), -3.0, 3.0, 0.02, prior=min(5 * travel, 1.0)),
        )

    def sense(self, theta: Array) -> tuple[Array | float, Array | float]:
        return theta[..., 0], 0.0


@register
class SensorDelay(_Sensor):
    id = "sensor_delay"
    equation = "measured q(t - T)"
    says = "The encoder of the {at} reports {delay} late."
    tries = (0.5, 2.0, 6.0)
    confused_with = ("actuator_delay",)
    remedy = "compare command and response with a second, faster sensor"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("delay", "s", 0.0, 0.1, 0.5 * max(ctx.period, 2e-3)),)

    def sense(self, theta: Array) -> tuple[Array | float, Array | float]:
        return 0.0, theta[..., 0]
