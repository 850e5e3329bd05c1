"""What stands between motor and link: the rotor's inertia, a spring, or a gap."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.effects.step import Array, Fields, Forces, Step
from mpge_jax.diagnosis.machine.model import TAKEN, actuators_of_joint, has_plain_law, rotor_inertia, within

SUBSTEPS = 4
"""Steps of the motor in one of the engine."""
BOUNCE = 0.2
"""Restitution at the ends of a gap where nothing is known of it."""
LEAST = 0.05
"""Least restitution: that of twice the critical damping."""
DAMPED_MOTOR = ":damped_motor"
"""Ending of the closer form of a flexible drive whose joint is damped at the motor."""


@register
class Armature(Effect):
    id, kinds = "armature", ("joint",)
    equation = "-J a"
    says = "The drive of the {at} has a rotor inertia of {inertia} that the model lacks."
    fields, set_const = ("dof_armature",), True
    confused_with = ("payload_mass", "actuator_delay")
    remedy = "fast chirps in two poses with different link inertia"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        dof = ctx.dof(place)
        scale = 0.1 * float(ctx.torque[dof]) / max(float(ctx.acceleration[dof]), 1e-3)
        return (Param("inertia", joint_unit(ctx, place, "kg m^2", "kg"), 0.0, 500 * scale, scale),)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.add("dof_armature", (ctx.dof(place),), theta[..., 0])


class _Motors:
    """The actuators of a joint at one step.

    Attributes:
        direct: [...] what the engine's actuators do to the link, in place of which the motor acts.
    """

    def __init__(self, xp: Any, ctx: Context, place: Place, s: Step) -> None:
        applied, m = s.f if s.engine is None else s.engine, ctx.model
        self.direct: Array = 0.0
        self._held: Array = 0.0
        self._servos = []
        for a in actuators_of_joint(m, place.index):
            gear, limits = float(m.actuator_gear[a, 0]), (s.force_low[..., a], s.force_high[..., a])
            self.direct = self.direct + gear * applied[..., a]
            slopes = gear * s.f_position[..., a], gear * s.f_velocity[..., a]
            # not asked of the model: other effects may give a plain motor a slope
            if xp is np and not (slopes[0].any() or slopes[1].any()):
                self._held = self._held + gear * within(s.f_free[..., a], *limits)
            else:
                self._servos.append((gear, s.f_free[..., a], slopes, *limits))

    def torque(self, xp: Any, ahead: Array, slip: Array) -> tuple[Array, Array, Array]:
        """Their torque where they are ahead of the observed link, in angle and speed, and by how much it falls with
        either."""
        total, hold, brake = self._held, 0.0, 0.0
        for gear, force, (by_angle, by_speed), low, high in self._servos:
            free = force + by_angle * ahead + by_speed * slip
            f = within(free, low, high, xp)
            follows = xp.where(free == f, gear, 0.0)
            total, hold, brake = total + gear * f, hold - follows * by_angle, brake - follows * by_speed
        return total, hold, brake


class Drive(Effect):
    """Motor and link as two bodies: the nominal armature is the motor, the recorded angle the link's.

    The motor's state (angle, speed) is the effect's memory; the link feels the torque between the two in place of the
    actuator's. A servo follows the motor: its gain on speed is taken from the engine, whose implicit steps would let it
    hold the link.
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

    def rest(self, xp: Any, ctx: Context, place: Place, theta: Array, torque: Array, hold: Array) -> Array:
        """Twist that carries a torque, which falls with the twist as a servo's does (`hold`: by how much)."""
        raise NotImplementedError

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        return self.settled(xp, ctx, place, theta, s)

    def settled(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, damped: Array = 0.0
    ) -> tuple[Array, Array]:
        """Angle and speed of a motor that moves along with its link; with `damped` [...], a damping of its own."""
        q, v = s.q[..., ctx.qadr(place)], s.v[..., ctx.dof(place)]
        torque, hold, _ = _Motors(xp, ctx, place, s).torque(xp, 0 * q, 0 * q)
        return q + self.rest(xp, ctx, place, theta, torque - damped * v, xp.maximum(hold, 0.0)), v


@register
class JointFlexibility(Drive):
    id, closer = "joint_flexibility", (DAMPED_MOTOR,)
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

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any, damped: Array = 0.0
    ) -> tuple[Forces, Any]:
        """With `damped` [...], a damping of the motor itself."""
        inertia = rotor_inertia(ctx.model, place.index)
        stiffness, damping = theta[..., 0], theta[..., 1]
        q, v = s.q[..., ctx.qadr(place)], s.v[..., ctx.dof(place)]
        angle, speed = memory
        motors = _Motors(xp, ctx, place, s)
        h = s.dt / SUBSTEPS
        harder, mass = stiffness * h, inertia + h * (damping + damped) + h * h * stiffness
        impulse, slip, link = 0.0, speed - v, q
        for _ in range(SUBSTEPS):
            torque, hold, brake = motors.torque(xp, angle - q, slip)
            passed = stiffness * (angle - link) + damping * slip
            # linearly implicit in the motor's speed
            free = torque - passed - harder * slip - (damped + hold * h) * speed
            gain = h * free / (mass + h * (brake + h * hold))
            speed, slip = speed + gain, slip + gain
            impulse = impulse + passed + harder * slip + damping * gain
            angle, link = angle + h * speed, link + h * v
        impulse = impulse / SUBSTEPS
        return Forces(joint=impulse - motors.direct), (angle, speed)

    def rest(self, xp: Any, ctx: Context, place: Place, theta: Array, torque: Array, hold: Array) -> Array:
        return torque / (theta[..., 0] + hold)


@register
class Backlash(Drive):
    """The motor moves freely in the gap and bounces off the link at its ends.

    How much it bounces decides how long it takes to come to rest, and differs between gears: it is fitted with the
    gap.
    """

    id = "backlash"
    equation = "motor and link joined through a gap of free travel, at whose ends they bounce"
    says = "The drive of the {at} has a free travel (backlash) of {gap}."
    confused_with = ("actuator_deadzone", "coulomb_friction", "actuator_delay")
    remedy = "slow reversals with and without a load that holds the gap closed"
    inertial = rugged = True

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        travel = max(float(ctx.travel[ctx.dof(place)]), 1e-2)
        return (
            Param("gap", joint_unit(ctx, place, "rad", "m"), 0.0, travel, 0.02 * travel),
            Param("restitution", "1", LEAST, 0.9, 0.1, prior=0.3),
        )

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        gap = self.params(ctx, place)[0].scale
        return np.array([[0.5 * gap, BOUNCE], [2.0 * gap, BOUNCE]])

    def detours(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """After a few bounces the motor may be anywhere: the fit is rough in both."""
        gap, restitution = theta
        others = [[k * gap, restitution] for k in (0.85, 0.95, 1.05, 1.15)]
        return np.array([*others, *([k * gap, e] for k in (0.9, 1.0, 1.1) for e in (0.05, 0.2, 0.35, 0.5))])

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        """A gap alone is enough."""
        return super().from_report(ctx, place, {"restitution": BOUNCE, **values})

    def resumed(
        self, theta: Array, memory: Any, reached: tuple[Array, Array], start: tuple[Array, Array]
    ) -> tuple[Any, Array]:
        """A motor that touches the link goes along with it. One inside the gap does not; it struck the link a moment
        ago or is about to, when no smoother knows the link's speed as well as the run-up does."""
        (q, v), (q0, v0) = reached, start
        angle, speed, change, farther, _ = memory
        half = 0.5 * theta[:, 0]
        touches = np.abs(angle - q) >= half
        angle = np.where(touches, angle + q0 - q, np.clip(angle, q0 - half, q0 + half))
        v0 = np.where(touches, v0, v)
        return (angle, speed + v0 - v, 0.0 * change, 0.0 * farther, v0), v0

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        """The motor's angle and speed; by how much the contact was to change the link's speed in the last step, how
        much farther than here the engine then moves it, and its speed before.
        """
        angle, speed = super().memory(xp, ctx, place, theta, s)
        return angle, speed, 0.0 * angle, 0.0 * angle, speed + 0.0

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        motor, link = rotor_inertia(ctx.model, place.index), s.inertia(ctx.dof(place))
        q, v = s.q[..., ctx.qadr(place)], s.v[..., ctx.dof(place)]
        angle, speed, change, farther, before = memory
        # a link that something else holds, or that others push, does not do what the contact alone would have it do
        obeyed = xp.where(change != 0.0, (v - before) / xp.where(change != 0.0, change, 1.0), 0.0)
        angle = angle + xp.clip(obeyed, 0.0, 1.0) * farther
        motors = _Motors(xp, ctx, place, s)
        h = s.dt / SUBSTEPS
        # a spring and damper between the two, as stiff as the steps allow
        rate, reduced = 0.25 / h, motor * link / (motor + link)
        stiffness = reduced * rate**2
        damping = 2.0 * damping_ratio(xp, theta[..., 1]) * reduced * rate
        link_angle, link_speed, impulse, half = q, v, 0.0, 0.5 * theta[..., 0]
        for _ in range(SUBSTEPS):
            twist = angle - link_angle
            side = xp.sign(twist)
            depth = side * twist - half
            pushed = stiffness * depth + damping * side * (speed - link_speed)
            passed = xp.where(depth > 0.0, side * xp.maximum(pushed, 0.0), 0.0)
            torque, hold, brake = motors.torque(xp, angle - q, speed - v)
            # linearly implicit in what a servo does as the motor moves on
            speed = speed + h * (torque - passed - hold * h * speed) / (motor + h * brake + h * h * hold)
            link_speed = link_speed + h * passed / link
            angle, link_angle = angle + h * speed, link_angle + h * link_speed
            impulse = impulse + passed / SUBSTEPS
        # the engine moves the link by its last speed, or the mean: the two are to stay as far apart as they were found
        halves = ctx.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        farther = q + s.dt * (0.5 * (v + link_speed) if halves else link_speed) - link_angle
        return Forces(joint=impulse - motors.direct), (angle, speed, link_speed - v, farther, v + 0.0)

    def rest(self, xp: Any, ctx: Context, place: Place, theta: Array, torque: Array, hold: Array) -> Array:
        # a servo may hold the motor inside the gap
        half, side = 0.5 * theta[..., 0], xp.sign(torque)
        inside = torque / xp.maximum(hold, 1e-12)
        return xp.where(xp.abs(torque) < hold * half, inside, side * half)


def restitution_of(ratio: np.ndarray) -> np.ndarray:
    """Share of its speed with which a mass bounces off a spring and damper of that damping ratio, which do not hold it
    back: it leaves where the force is 0 (Schwager and Poeschel, 2007)."""
    root = np.sqrt(np.maximum(np.abs(1.0 - ratio**2), 1e-12))
    phase = np.where(ratio < 1.0, np.arccos(np.minimum(ratio, 1.0)), np.arccosh(np.maximum(ratio, 1.0)))
    exponent = np.where(ratio == 1.0, 2.0, 2.0 * ratio * phase / root)
    return np.exp(-exponent)


_RATIOS = np.linspace(2.0, 0.0, 401)
_RESTITUTIONS = restitution_of(_RATIOS)


def damping_ratio(xp: Any, restitution: Array) -> Array:
    """Inverse of `restitution_of` from `LEAST` to 1, from a table."""
    return xp.interp(restitution, _RESTITUTIONS, _RATIOS)
