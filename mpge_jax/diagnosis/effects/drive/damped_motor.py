"""A flexible drive whose joint is damped at its motor, where most bearings and seals of a gear are."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.closer import Closer, closer_form
from mpge_jax.diagnosis.effects.context import Context, Param, Place
from mpge_jax.diagnosis.effects.drive.flexible import DAMPED_MOTOR, JointFlexibility
from mpge_jax.diagnosis.effects.step import Array, Fields, Follower, Forces, Step

SHARES = (0.5, 1.0)
"""To start from."""


@closer_form
class DampedMotor(Closer):
    """Where motor and link move as one, nobody can tell which of them a joint's damping holds back, and a model's is of
    both. Where the drive yields, what acts on the motor (Spong, 1987) does not damp how the link swings on it.
    """

    ending = DAMPED_MOTOR
    adds = "; {motor_share} of the damping that the model gives the joint acts on its motor."
    runtime = inertial = True
    set_const = True
    plain: JointFlexibility

    def __init__(self, plain: JointFlexibility) -> None:
        super().__init__(plain)
        self.fields = (*plain.fields, "dof_damping")
        self.equation = f"{plain.equation}; a share of the joint's damping on the motor"

    def fits(self, ctx: Context, place: Place) -> bool:
        return _damping(ctx, place) > 0.0

    def own(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("motor_share", "1", 0.0, 1.0, 0.1),)

    def starts_from(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        return np.array([[*theta, share] for share in SHARES])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        super().model(f, ctx, place, theta)
        f.add("dof_damping", ctx.dof(place), -theta[..., -1] * _damping(ctx, place))

    def remembers(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        return self.plain.remembers(ctx, place, theta[:, :-1])

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        return self.plain.settled(xp, ctx, place, theta[..., :-1], s, theta[..., -1] * _damping(ctx, place))

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        damped = theta[..., -1] * _damping(ctx, place)
        return self.plain.force(xp, ctx, place, theta[..., :-1], s, memory, damped)

    def follower(self, ctx: Context, place: Place, theta: np.ndarray, dt: float) -> Follower:
        damped = theta[:, -1] * _damping(ctx, place)
        return self.plain.follower(ctx, place, theta[:, :-1], dt, damped)


def _damping(ctx: Context, place: Place) -> float:
    """Of the model as given."""
    return float(ctx.model.dof_damping[ctx.dof(place)])
