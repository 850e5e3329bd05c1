"""Motor and link as two bodies: what the motors of a joint do, and what drives with a spring or a gap share."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.base import Effect
from mpge_jax.diagnosis.effects.context import Context, Place
from mpge_jax.diagnosis.effects.step import Array, Fields, Step
from mpge_jax.diagnosis.machine.model import TAKEN, actuators_of_joint, has_plain_law, rotor_inertia, within

SUBSTEPS = 4
"""Steps of the motor in one of the engine."""


class Motors:
    """The actuators of a joint at one step.

    Attributes:
        direct: [...] what the engine's actuators do to the link, in place of which the motor acts.
        servos: whether any is a servo in the model as given.
    """

    def __init__(self, xp: Any, ctx: Context, place: Place, s: Step) -> None:
        applied, m = s.f if s.engine is None else s.engine, ctx.model
        self.direct: Array = 0.0
        self.servos = False
        self._held: Array = 0.0
        self._servos = []
        for a in actuators_of_joint(m, place.index):
            self.servos |= bool(m.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE)
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
        torque, hold, _ = Motors(xp, ctx, place, s).torque(xp, 0 * q, 0 * q)
        return q + self.rest(xp, ctx, place, theta, torque - damped * v, xp.maximum(hold, 0.0)), v
