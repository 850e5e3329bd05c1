"""What the encoders report instead of the truth."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import (
    Array,
    Context,
    Effect,
    Param,
    Place,
    all_places,
    joint_unit,
    register,
)


class _Sensor(Effect):
    kinds, side, senses = ("joint",), "sensor", True

    def places(self, ctx: Context) -> list[Place]:
        """Every scalar joint: the sensors of a floating base can be late or off as well."""
        return all_places(ctx, "joint")


@register
class EncoderOffset(_Sensor):
    id = "encoder_offset"
    equation = "measured q = q + q0"
    remedy = "hold still in poses over the full range; compare with a mechanical stop"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        travel = max(float(ctx.travel[ctx.dof(place)]), 0.05)
        return (
            Param("offset", joint_unit(ctx, place, "rad", "m"), -3.0, 3.0, 0.02, prior=min(5 * travel, 1.0)),
        )

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([[0.0]])

    def sense(self, theta: Array) -> tuple[Array | float, Array | float]:
        return theta[..., 0], 0.0

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"The encoder of the {place.name} reads {values['offset']} too much."


@register
class SensorDelay(_Sensor):
    id = "sensor_delay"
    equation = "measured q(t - T)"
    remedy = "compare command and response with a second, faster sensor"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("delay", "s", 0.0, 0.1, 0.5 * max(ctx.period, 2e-3)),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.array([[1.0], [3.0]]) * max(ctx.period, 2e-3)

    def sense(self, theta: Array) -> tuple[Array | float, Array | float]:
        return 0.0, theta[..., 0]

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        return f"The encoder of the {place.name} reports {values['delay']} late."
