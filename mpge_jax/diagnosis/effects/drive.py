"""What stands between motor and link: the rotor's inertia, a spring, or a gap."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.effects.step import Array, Fields, Forces, Step
from mpge_jax.diagnosis.model import TAKEN, actuators_of_joint, has_plain_law, rotor_inertia


@register
class Armature(Effect):
    id, kinds = "armature", ("joint",)
    equation = "-J a"
    says = "The drive of the {at} has a rotor inertia of {inertia} that the model lacks."
    fields, set_const = ("dof_armature",), True
    remedy = "fast chirps in two poses with different link inertia"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        dof = ctx.dof(place)
        scale = 0.1 * float(ctx.torque[dof]) / max(float(ctx.acceleration[dof]), 1e-3)
        return (Param("inertia", joint_unit(ctx, place, "kg m^2", "kg"), 0.0, 500 * scale, scale),)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.add("dof_armature", (ctx.dof(place),), theta[..., 0])


class Drive(Effect):
    """Motor and link as two bodies: the nominal armature is the motor, the recorded angle the link's.

    The motor's state (angle, speed) is the effect's memory, stepped implicitly; the link feels the coupling
    torque in place of the actuator's. A servo follows the motor: its gain on speed is taken from the engine, whose
    implicit steps would let it hold the link.
    """

    kinds, tier, runtime, order = ("joint",), 3, True, 6
    fields, set_const = ("dof_armature", "actuator_armature", "actuator_biasprm"), True

    def places(self, ctx: Context) -> list[Place]:
        m = ctx.model
        return [
            p for p in super().places(ctx) if rotor_inertia(m, p.index) > 0 and actuators_of_joint(m, p.index)
        ]

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.add("dof_armature", (ctx.dof(place),), -float(ctx.model.dof_armature[ctx.dof(place)]))
        for a in actuators_of_joint(ctx.model, place.index):
            if ctx.model.actuator_armature[a] > 0:
                f.set("actuator_armature", (a,), 0.0)
            if has_plain_law(ctx.model, a):
                f.set("actuator_biasprm", (a, TAKEN), f.get("actuator_biasprm", (a, 2)))
                f.set("actuator_biasprm", (a, 2), 0.0)

    def coupling(
        self, xp: Any, ctx: Context, place: Place, theta: Array, twist: Array
    ) -> tuple[Array, Array, Array]:
        """(spring torque, its slope, damping) at a twist of motor against link."""
        raise NotImplementedError

    def rest(self, xp: Any, ctx: Context, place: Place, theta: Array, torque: Array, hold: Array) -> Array:
        """Twist that carries a torque, which falls with the twist as a servo's does (`hold`: by how much)."""
        raise NotImplementedError

    def fades(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """Seconds [n] after which the motor has forgotten where it was."""
        raise NotImplementedError

    def remembers(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """Until it fades, where the torques before the start are known: no filter holds them."""
        known = all(has_plain_law(ctx.model, a) for a in actuators_of_joint(ctx.model, place.index))
        return self.fades(ctx, place, theta) if known else np.zeros(len(theta))

    def _torque(
        self, xp: Any, ctx: Context, place: Place, s: Step, ahead: Array, slip: Array
    ) -> tuple[Array, Array, Array]:
        """The motors' torque where they are ahead of the observed link, in angle and speed, and by how much it falls
        with either."""
        total, hold, brake = 0.0 * ahead, 0.0 * ahead, 0.0 * ahead
        for a in actuators_of_joint(ctx.model, place.index):
            g = float(ctx.model.actuator_gear[a, 0])
            by_angle, by_speed = g * s.f_position[..., a], g * s.f_velocity[..., a]
            free = s.f_free[..., a] + by_angle * ahead + by_speed * slip
            f = xp.clip(free, s.force_low[..., a], s.force_high[..., a])
            follows = xp.where(free == f, 1.0, 0.0)
            total, hold, brake = total + g * f, hold - g * follows * by_angle, brake - g * follows * by_speed
        return total, hold, brake

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        q, v = s.q[..., ctx.qadr(place)], s.v[..., ctx.dof(place)]
        torque, hold, _ = self._torque(xp, ctx, place, s, 0 * q, 0 * q)
        return q + self.rest(xp, ctx, place, theta, torque, xp.maximum(hold, 0.0)), v

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        dof = ctx.dof(place)
        inertia = rotor_inertia(ctx.model, place.index)
        q, v = s.q[..., ctx.qadr(place)], s.v[..., dof]
        angle, speed = memory
        sub = 4
        h = s.dt / sub
        impulse = 0.0
        for i in range(sub):
            twist, slip = angle - (q + v * (i * h)), speed - v
            torque, hold, brake = self._torque(xp, ctx, place, s, angle - q, slip)
            spring, slope, damping = self.coupling(xp, ctx, place, theta, twist)
            passed = spring + damping * slip
            # linearly implicit in the motor's speed
            accel = (torque - passed - slope * h * slip - hold * h * speed) / (
                inertia + h * (damping + brake) + h * h * (slope + hold)
            )
            speed_next = speed + h * accel
            transmitted = passed + slope * h * (speed_next - v) + damping * (speed_next - speed)
            angle = angle + h * speed_next
            speed = speed_next
            impulse = impulse + transmitted / sub
        applied = s.f if s.engine is None else s.engine
        direct = sum(
            float(ctx.model.actuator_gear[a, 0]) * applied[..., a]
            for a in actuators_of_joint(ctx.model, place.index)
        )
        return Forces(joint=impulse - direct), (angle, speed)


@register
class JointFlexibility(Drive):
    id = "joint_flexibility"
    equation = "motor and link joined by k twist + d d(twist)/dt"
    says = "The drive of the {at} yields like a spring of {stiffness} with a damping of {damping}."
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
        """Three time constants with which the motor swings, or creeps, to its rest."""
        inertia = rotor_inertia(ctx.model, place.index)
        stiffness, damping = np.maximum(theta, 1e-12).T
        return np.maximum(6.0 * inertia / damping, 3.0 * damping / stiffness)

    def coupling(
        self, xp: Any, ctx: Context, place: Place, theta: Array, twist: Array
    ) -> tuple[Array, Array, Array]:
        return theta[..., 0] * twist, theta[..., 0], theta[..., 1]

    def rest(self, xp: Any, ctx: Context, place: Place, theta: Array, torque: Array, hold: Array) -> Array:
        return torque / (theta[..., 0] + hold)


@register
class Backlash(Drive):
    id = "backlash"
    equation = "motor and link joined through a gap of free travel"
    says = "The drive of the {at} has a free travel (backlash) of {gap}."
    tries = (0.5, 2.0)
    remedy = "slow reversals with and without a load that holds the gap closed"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        travel = max(float(ctx.travel[ctx.dof(place)]), 1e-2)
        return (Param("gap", joint_unit(ctx, place, "rad", "m"), 0.0, travel, 0.02 * travel),)

    def fades(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """Long enough to cross the gap and come to rest in it."""
        return np.full(len(theta), 0.25)

    def _stiffness(self, ctx: Context, place: Place) -> tuple[float, float]:
        """Contact as stiff as the timestep allows for the motor's inertia, near-critically damped."""
        inertia = rotor_inertia(ctx.model, place.index)
        rate = 0.25 / float(ctx.model.opt.timestep)
        return inertia * rate**2, 1.4 * inertia * rate

    def coupling(
        self, xp: Any, ctx: Context, place: Place, theta: Array, twist: Array
    ) -> tuple[Array, Array, Array]:
        k, d = self._stiffness(ctx, place)
        half = 0.5 * theta[..., 0]
        past = xp.sign(twist) * xp.maximum(xp.abs(twist) - half, 0.0)
        touching = xp.where(xp.abs(twist) > half, 1.0, 0.0)
        return k * past, k * touching, d * touching

    def rest(self, xp: Any, ctx: Context, place: Place, theta: Array, torque: Array, hold: Array) -> Array:
        # a servo may hold the motor inside the gap
        half, side = 0.5 * theta[..., 0], xp.sign(torque)
        past = torque - side * hold * half
        inside = torque / xp.maximum(hold, 1e-12)
        beyond = side * half + past / (self._stiffness(ctx, place)[0] + hold)
        return xp.where(xp.abs(torque) < hold * half, inside, beyond)
