"""A drive that yields like a spring."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.base import register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.effects.drive.motors import SUBSTEPS, Drive, Motors
from mpge_jax.diagnosis.effects.step import Array, Follower, Forces, Step
from mpge_jax.diagnosis.machine.model import actuators_of_joint, has_plain_law, rotor_inertia

DAMPED_MOTOR = ":damped_motor"
"""Ending of the closer form of a flexible drive whose joint is damped at the motor."""


@register
class JointFlexibility(Drive):
    id, closer, inertial = "joint_flexibility", (DAMPED_MOTOR,), True
    equation = "motor and link joined by k twist + d d(twist)/dt"
    says = "The drive of the {at} yields like a spring of {stiffness} with a damping of {damping}."
    confused_with = ("actuator_delay", "backlash")
    remedy = "a chirp past the resonance"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        t = float(ctx.torque[ctx.dof(place)])
        inertia = rotor_inertia(ctx.model, place.index)
        k = max(20 * t, 10.0 * inertia)
        d = 0.2 * np.sqrt(k * inertia)
        return (
            Param(
                "stiffness",
                joint_unit(ctx, place, "N m/rad", "N/m"),
                1e-2 * k,
                1e3 * k,
                0.1 * k,
                prior=20 * k,
            ),
            Param("damping", joint_unit(ctx, place, "N m s/rad", "N s/m"), 0.0, 1e3 * d, d),
        )

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        k, d = self.params(ctx, place)
        return np.array(
            [[10 * k.scale * f, d.scale * f**0.5] for f in (0.04, 0.12, 0.4, 1.2, 5.0, 25.0, 125.0)]
        )

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return []

    def fades(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """Seconds [n] after which the motor has forgotten where it was: three time constants with which it swings, or
        creeps, to its rest."""
        inertia = rotor_inertia(ctx.model, place.index)
        stiffness, damping = np.maximum(theta, 1e-12).T
        return np.maximum(6.0 * inertia / damping, 3.0 * damping / stiffness)

    def remembers(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """Until it fades, where the torques before the start are known: no filter holds them."""
        known = all(has_plain_law(ctx.model, a) for a in actuators_of_joint(ctx.model, place.index))
        return self.fades(ctx, place, theta) if known else np.zeros(len(theta))

    def settled(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, damped: Array = 0.0
    ) -> tuple[Array, Array]:
        angle, speed = super().settled(xp, ctx, place, theta, s, damped)
        q, v = s.q[..., ctx.qadr(place)], s.v[..., ctx.dof(place)]
        return angle - q + _in_step(ctx, q, v), speed

    def force(
        self,
        xp: Any,
        ctx: Context,
        place: Place,
        theta: Array,
        s: Step,
        memory: Any,
        damped: Array = 0.0,
        speeding: Array | None = None,
    ) -> tuple[Forces, Any]:
        """Two bodies on a spring move exactly, as steps that are short for the machine may be long for a light motor;
        what a servo's torque changes by in a step is taken at its middle.

        Args:
            damped: [...] damping of the motor itself. speeding: [...] acceleration of a link whose motion is given
                (None: it yields to the spring).
        """
        motors = Motors(xp, ctx, place, s)
        yields, gained = (1.0 / s.inertia(ctx.dof(place)), 0.0) if speeding is None else (0.0, speeding)
        inertia = rotor_inertia(ctx.model, place.index)
        stiffness, damping = theta[..., 0], theta[..., 1]
        q, v = s.q[..., ctx.qadr(place)], s.v[..., ctx.dof(place)]
        (angle, speed), (link, pace), impulse = memory, (_in_step(ctx, q, v), v), 0.0
        steps = SUBSTEPS if motors.servos else 1
        h, together = s.dt / steps, 1.0 / inertia + yields
        for _ in range(steps):
            twist, slip = angle - link, speed - pace
            torque, hold, brake = motors.torque(xp, angle - q, speed - v)
            brake, back = brake + damped, stiffness * twist + damping * slip
            late = (0.5 * h * brake + 0.25 * h * h * hold) / inertia
            torque = (torque - damped * speed - 0.5 * h * hold * speed + late * back) / (1.0 + late)
            push = torque / inertia - gained
            further, faster = _swung(xp, stiffness * together, damping * together, push, twist, slip, h)
            passed = (push * h - faster) / together
            # the centre of both moves on by what acts from outside
            aside = (
                yields * (0.5 * h * h * torque - inertia * (further - slip * h)) / (1.0 + yields * inertia)
            )
            link, pace = link + h * pace + 0.5 * h * h * gained + aside, pace + yields * passed + h * gained
            angle, speed = link + twist + further, pace + slip + faster
            impulse = impulse + passed
        return Forces(joint=impulse / s.dt - motors.direct), (angle, speed)

    def follower(
        self, ctx: Context, place: Place, theta: np.ndarray, dt: float, damped: Array = 0.0
    ) -> Follower:
        """With `damped` [n], a damping of the motor itself."""
        dof = ctx.dof(place)

        def follow(s: Step, then: tuple[Array, Array], memory: Any) -> Any:
            speeding = (then[1] - s.v[:, dof]) / dt
            return self.force(np, ctx, place, theta, s, memory, damped, speeding)[1]

        return follow

    def rest(self, xp: Any, ctx: Context, place: Place, theta: Array, torque: Array, hold: Array) -> Array:
        return torque / (theta[..., 0] + hold)


def _in_step(ctx: Context, q: Array, v: Array) -> Array:
    """Where a link is when it has its speed: steps of all but Runge-Kutta move it by the speed with which they end, as
    far as it comes in half a step more."""
    moved = ctx.model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4
    return q - 0.5 * ctx.model.opt.timestep * v if moved else q


def _swung(
    xp: Any, square: Array, friction: Array, push: Array, x: Array, speed: Array, h: float
) -> tuple[Array, Array]:
    """By how much x and x' change in `h` s where x'' = push - square x - friction x'."""
    half = 0.5 * friction
    determinant = half**2 - square
    swings, root = determinant < 0.0, xp.sqrt(xp.maximum(xp.abs(determinant), 1e-30))
    # of the slower of two exponentials, where it creeps
    faded = xp.exp((xp.where(swings, 0.0, root) - half) * h)
    less = -xp.expm1(xp.where(swings, 0.0, -2.0 * root * h))
    turned = faded * xp.where(swings, xp.sin(root * h), 0.5 * less) / root
    kept = faded * xp.where(swings, xp.cos(root * h), 1.0 - 0.5 * less) + half * turned
    rest, start = (1.0 - kept) / square, push - square * x
    return turned * speed + rest * start, turned * (start - friction * speed) - square * rest * speed
