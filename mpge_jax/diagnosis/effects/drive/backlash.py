"""A drive with a gap of free travel."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.base import register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.effects.drive.motors import SUBSTEPS, Drive, Motors
from mpge_jax.diagnosis.effects.step import Array, Forces, Step
from mpge_jax.diagnosis.machine.model import rotor_inertia

BOUNCE = 0.2
"""Restitution at the ends of a gap where nothing is known of it."""
LEAST = 0.05
"""Least restitution: that of twice the critical damping."""


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
        motors = Motors(xp, ctx, place, s)
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
