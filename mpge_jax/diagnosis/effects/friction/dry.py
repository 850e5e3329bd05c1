"""Dry friction at a joint: MuJoCo's `frictionloss`, made stiff, so that it really sticks."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place
from mpge_jax.diagnosis.effects.friction.scales import (
    damping_param,
    falling_param,
    friction_of_model,
    torque_param,
)
from mpge_jax.diagnosis.effects.step import Array, Fields, Forces, Step
from mpge_jax.diagnosis.machine.model import lever_arms

ELASTIC = ":elastic"
"""How the identifier of the form of a law ends that gives way before it slides."""
FALLING = ":falling"
"""How the identifier of the form of a law ends that falls from rest to sliding."""
CREEPING = "coulomb_friction:creeping"
"""The identifier of plain dry friction that creeps as MuJoCo's own does."""
GRADUAL = ":gradual"
"""How the identifier of the form of a law ends that sets in gradually with the speed."""
FALLS_BY = (0.4, 1.2, 4.0)
"""Speeds by which friction has fallen to start from, in their scale."""
SOLIMP = (0.98, 0.99, 0.001, 0.5, 2.0)
"""Impedance of dry friction: 1 % of the mobility is left as regularisation."""


FIELDS = ("dof_frictionloss", "dof_solref", "dof_solimp")
"""Fields of the model that dry friction changes."""


def stiff_dry_friction(f: Fields, ctx: Context, dof: int, like: Array) -> None:
    """Let dry friction stop a joint within a timestep (MuJoCo's default takes about ten and creeps)."""
    xp, one = f.xp, like * 0 + 1.0
    damping = -0.9 / float(ctx.model.opt.timestep)
    f.set("dof_solref", dof, xp.stack([-1.0 * one, damping * one], -1))
    f.set("dof_solimp", dof, xp.stack([s * one for s in SOLIMP], -1))


class Dry(Effect):
    """What laws of dry friction have in common."""

    kinds = ("joint",)
    closer: tuple[str, ...] = (ELASTIC,)
    fields = FIELDS

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        stiff_dry_friction(f, ctx, ctx.dof(place), theta[..., 0])


@register
class CoulombFriction(Dry):
    id = "coulomb_friction"
    closer: tuple[str, ...] = (GRADUAL, ELASTIC)
    equation = "-Fc sgn v"
    says = "The {at} has dry friction of {torque} that the model lacks."
    says_less = "The model has {torque} too much dry friction at the {at}."
    confused_with = ("viscous_damping", "actuator_deadzone", "backlash")
    remedy = "reverse the joint slowly many times, and also move it fast"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (torque_param(ctx, place, "torque", -friction_of_model(ctx, place)),)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        super().model(f, ctx, place, theta)
        f.add("dof_frictionloss", ctx.dof(place), theta[..., 0])


@register
class CreepingFriction(CoulombFriction):
    """The same as MuJoCo has it by itself: `frictionloss` with the given model's own softness, by default one with
    which a joint creeps that should stick. A machine that was simulated has it so, and what rubs in grease nearly does.
    It is asked for where the plain one stands.
    """

    id, form_of, closer = CREEPING, CoulombFriction.id, ()

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        f.add("dof_frictionloss", ctx.dof(place), theta[..., 0])


@register
class StribeckFriction(Dry):
    id, tier, runtime = "stribeck_friction", 2, True
    equation = "-(Fc + (Fs - Fc) exp(-(v/vs)^2)) sgn v"
    says = (
        "The {at} has dry friction that the model lacks: {static} to break loose, {coulomb} when it moves faster than "
        "about {velocity} (Stribeck)."
    )
    confused_with = ("coulomb_friction", "load_dependent_friction", "cogging_torque")
    remedy = "ramp the joint very slowly through zero speed, several times in each direction"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (
            torque_param(ctx, place, "coulomb"),
            torque_param(ctx, place, "rise"),
            falling_param(ctx, place),
        )

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        coulomb, rise, velocity = (theta[..., i] for i in range(3))
        return {"coulomb": coulomb, "static": coulomb + rise, "velocity": velocity}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        coulomb, static, velocity = (float(values[k]) for k in ("coulomb", "static", "velocity"))
        return np.array([coulomb, static - coulomb, velocity])

    def units(self, ctx: Context, place: Place) -> dict[str, str]:
        coulomb, rise, velocity = (p.unit for p in self.params(ctx, place))
        return {"coulomb": coulomb, "static": rise, "velocity": velocity}

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        c, s, v = self.params(ctx, place)
        return np.array([[0.7 * c.scale, 0.8 * s.scale, k * v.scale] for k in FALLS_BY])

    def containing(self, ctx: Context, place: Place, plainer: str, theta: np.ndarray) -> np.ndarray:
        if plainer != "coulomb_friction":
            return super().containing(ctx, place, plainer, theta)
        return np.array([[theta[0], 0.0, start[2]] for start in self.starts(ctx, place)])

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return [1]

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        left = not_yet_fallen(xp, s.v[..., ctx.dof(place)], theta[..., 2])
        return Forces(dry=theta[..., 0] + theta[..., 1] * left), memory


def not_yet_fallen(xp: Any, speed: Array, velocity: Array) -> Array:
    """Share [...] of what dry friction is more at rest that is left at a speed (Stribeck)."""
    return xp.exp(-xp.minimum((speed / velocity) ** 2, 50.0))


@register
class LoadDependentFriction(Dry):
    id, tier, runtime, order = "load_dependent_friction", 2, True, 7
    closer = (FALLING, ELASTIC)
    equation = "-(Fc + Kl |load|) sgn v, load = actuator force times gear"
    says = "The {at} has dry friction of {coulomb} plus {load_coefficient} times the torque that its drive gives."
    confused_with = ("coulomb_friction", "stribeck_friction", "actuator_gain")
    remedy = "make the same motion with two loads, lifting and lowering"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (torque_param(ctx, place, "coulomb"), Param("load_coefficient", "1", 0.0, 2.0, 0.1))

    def places(self, ctx: Context) -> list[Place]:
        return [p for p in super().places(ctx) if lever_arms(ctx.model, p.index)]

    def containing(self, ctx: Context, place: Place, plainer: str, theta: np.ndarray) -> np.ndarray:
        if plainer != "coulomb_friction":
            return super().containing(ctx, place, plainer, theta)
        return np.array([[theta[0], 0.0]])

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return [1]

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        load = sum(s.f[..., a] * g for a, g in lever_arms(ctx.model, place.index))
        return Forces(dry=theta[..., 0] + theta[..., 1] * xp.abs(load)), memory


@register
class GearLoadFriction(LoadDependentFriction):
    """The second form: the gear carries the motor's torque against that of gravity and the other links."""

    id, external = "load_dependent_friction:gear", True
    equation = "-(Fc + Kl |motor torque - external torque|) sgn v"
    says = (
        "The gear of the {at} has dry friction of {coulomb} plus {load_coefficient} times the torque between motor and "
        "load (motor torque less external torque)."
    )

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        motor = sum(s.f[..., a] * g for a, g in lever_arms(ctx.model, place.index))
        load = motor - s.external(ctx.dof(place))
        return Forces(dry=theta[..., 0] + theta[..., 1] * xp.abs(load)), memory


@register
class AsymmetricFriction(Dry):
    id, tier, runtime = "asymmetric_friction", 2, True
    equation = "Fc and b each with a value for v > 0 and for v < 0"
    says = (
        "The {at} has friction that differs by direction: dry {coulomb_forward} and viscous {viscous_forward} "
        "forwards, dry {coulomb_backward} and viscous {viscous_backward} backwards."
    )
    confused_with = ("actuator_bias", "coulomb_friction")
    remedy = "move both ways at several speeds, by the drive and by hand with the drive switched off"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (
            torque_param(ctx, place, "coulomb_forward"),
            torque_param(ctx, place, "coulomb_backward"),
            damping_param(ctx, place, "viscous_forward"),
            damping_param(ctx, place, "viscous_backward"),
        )

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        s = np.array([p.scale for p in self.params(ctx, place)])
        return np.array([s * [1.0, 0.5, 0.5, 0.3], s * [0.5, 1.0, 0.3, 0.5]])

    def containing(self, ctx: Context, place: Place, plainer: str, theta: np.ndarray) -> np.ndarray:
        if plainer == "coulomb_friction":
            return np.array([[theta[0], theta[0], 0.0, 0.0]])
        if plainer.partition(":")[0] == "viscous_damping":
            return np.array([[0.0, 0.0, theta[0], theta[0]]])
        return super().containing(ctx, place, plainer, theta)

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return [0, 1, 2, 3]

    def contrasts(self, ctx: Context, place: Place) -> np.ndarray:
        """The directions differ."""
        return np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]])

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        v = s.v[..., ctx.dof(place)]
        forward = v > 0
        dry = xp.where(forward, theta[..., 0], theta[..., 1])
        viscous = xp.where(forward, theta[..., 2], theta[..., 3])
        return Forces(dry=dry, joint=-viscous * v), memory
