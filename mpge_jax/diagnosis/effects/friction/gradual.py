"""Dry friction that sets in gradually as a joint begins to move."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect
from mpge_jax.diagnosis.effects.closer import Closer, closer_form
from mpge_jax.diagnosis.effects.context import Context, Param, Place
from mpge_jax.diagnosis.effects.friction.dry import GRADUAL, stiff_dry_friction
from mpge_jax.diagnosis.effects.friction.scales import falling_param
from mpge_jax.diagnosis.effects.step import Array, Fields, Forces, Step

BY = (0.3, 1.0)
"""Speeds to start from, in their scale."""
FASTEST = 2.0
"""Speed, at most, in that scale: what sets in later than at a fifth of the usual speed is damping."""
MORE = 1.05
"""Level to start from, in that of the plain law, which stands for what is less at low speeds."""


@closer_form
class Gradual(Closer):
    """A level of dry friction that is reached by and by: what rubs in grease creeps under any force. Makers of robot
    arms describe their joints so (a sigmoid of the speed; Petrone et al., The dynamic model of the UR10 robot and its
    ROS2 integration, 2025). The lower the speed, the more nearly this is dry friction itself.
    """

    ending, imitated_by = GRADUAL, "viscous_damping"
    adds = ", which sets in gradually: it has reached three quarters of that at {velocity}."
    runtime = inertial = True

    def __init__(self, plain: Effect) -> None:
        super().__init__(plain)
        self.equation = "-Fc tanh(v/vs)"

    def own(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        falls = falling_param(ctx, place)
        return (Param("velocity", falls.unit, 0.0, FASTEST * falls.scale, falls.scale),)

    def starts_from(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        scale = falling_param(ctx, place).scale
        return np.array([[*(MORE * theta), k * scale] for k in BY])

    def containing(self, ctx: Context, place: Place, plainer: str, theta: np.ndarray) -> np.ndarray:
        if plainer != self.plain.id:
            return super().containing(ctx, place, plainer, theta)
        return np.array([[*theta, 0.0]])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        stiff_dry_friction(f, ctx, ctx.dof(place), theta[..., 0])

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        level, dof = theta[..., 0], ctx.dof(place)
        # steeper, a force that is told a step late would move a joint on from rest and stop it in turn
        velocity = xp.maximum(theta[..., 1], level * s.dt / s.inertia(dof))
        return Forces(dry=level * xp.tanh(xp.abs(s.v[..., dof]) / xp.maximum(velocity, 1e-12))), memory
