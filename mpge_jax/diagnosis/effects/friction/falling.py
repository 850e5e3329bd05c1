"""Dry friction of a law that takes more to break loose than to keep sliding."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect
from mpge_jax.diagnosis.effects.closer import Closer, closer_form
from mpge_jax.diagnosis.effects.context import Context, Param, Place
from mpge_jax.diagnosis.effects.friction.dry import FALLING, FALLS_BY, not_yet_fallen
from mpge_jax.diagnosis.effects.friction.scales import falling_param
from mpge_jax.diagnosis.effects.step import Array, Forces, Step

RISE, SLIDING = 0.3, 0.9
"""What is started from: how much more it is at rest, and the plain law's parameters of which share."""


@closer_form
class Falling(Closer):
    """A law of dry friction that is larger at rest, by a share of itself, and falls with the speed (Stribeck).

    Teeth of gears that are pressed together stick as they slide: in proportion to the load (Duclusaud et al., Extended
    friction models for the physics simulation of servo actuators, 2024). Friction falls so where a joint is slow, and
    damping grows where it is fast: without one the other may explain nothing.
    """

    ending, further, beside = FALLING, 2, "viscous_damping"
    adds = "; at rest that is {static_ratio} times as large, and falls until about {velocity} (Stribeck)."
    runtime = True

    def __init__(self, plain: Effect) -> None:
        super().__init__(plain)
        self.equation = f"F (1 + r exp(-(v/vs)^2)), where F is {plain.equation}"

    def own(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return Param("rise", "1", 0.0, 3.0, 0.1), falling_param(ctx, place)

    def starts_from(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        scale = falling_param(ctx, place).scale
        return np.array([[*(SLIDING * theta), RISE, k * scale] for k in FALLS_BY])

    def report_own(self, ctx: Context, place: Place, own: np.ndarray) -> dict[str, np.ndarray]:
        return {"static_ratio": 1.0 + own[..., 0], "velocity": own[..., 1]}

    def own_from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> list[float]:
        return [float(values["static_ratio"]) - 1.0, float(values["velocity"])]

    def own_units(self, ctx: Context, place: Place) -> dict[str, str]:
        rise, velocity = (p.unit for p in self.own(ctx, place))
        return {"static_ratio": rise, "velocity": velocity}

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        forces, _ = self.plain.force(xp, ctx, place, theta[..., : -self.further], s, ())
        left = not_yet_fallen(xp, s.v[..., ctx.dof(place)], theta[..., -1])
        return Forces(dry=forces.dry * (1.0 + theta[..., -2] * left)), memory
