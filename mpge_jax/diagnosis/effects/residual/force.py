"""Force that no effect of the vocabulary explains, as a smooth function of what goes on at the place where it acts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect
from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.effects.friction.dry import FIELDS, stiff_dry_friction
from mpge_jax.diagnosis.effects.residual.axis import ANGLE, KNOTS, LOAD, SPEED, TURNED, WITHIN_TURN, Axis
from mpge_jax.diagnosis.effects.step import Array, Fields, Forces, Step
from mpge_jax.diagnosis.machine.model import is_joint_transmission

RESIDUAL = "residual"
FADES = 0.5
"""Share of the greatest speed seen over which force that drives a joint on fades beyond that speed."""


def splines(xp: Any, x: Array, count: int, around: bool = False) -> list[Array]:
    """`count` uniform cubic B-splines over [0, 1] at x [...]; outside as at the ends, or, `around`, as if 1 were 0.
    They sum to one."""
    t = count * xp.mod(x, 1.0) if around else xp.clip(x, 0.0, 1.0) * (count - 3)
    first = 0.0 if around else -1.0
    u = xp.abs(t[None] - (first + np.arange(count)).reshape(count, *(1,) * np.ndim(t)))
    if around:
        u = xp.minimum(u, count - u)
    rest = xp.maximum(2.0 - u, 0.0)
    # products: numpy takes several times as long for a third power
    near, far = 2.0 / 3.0 - u * u * (1.0 - 0.5 * u), rest * rest * rest / 6.0
    return list(xp.where(u < 1.0, near, far))


class Residual(Effect):
    """A force on a joint, as a function of one or two inputs: cubic splines with a value for every knot.

    It is bounded, as beyond the range of an input the function stays what it is at the end; and it cannot drive a joint
    away, as beyond the greatest speed that was seen, force in the direction of the motion fades to nothing. Or it is
    the level of dry friction, on top of any that is named: what rubs holds a joint still, which no smooth function of
    the speed does.

    Args:
        axes: the inputs. below: greatest speed seen (rad/s or m/s). dry: whether it is a level of dry friction.
    """

    kinds, tier, runtime, simulated = ("joint",), 3, True, False

    def __init__(self, axes: tuple[Axis, ...], below: float, dry: bool = False) -> None:
        if not 1 <= len(axes) <= 2 or not below > 0:
            raise ValueError("a residual has one or two inputs, and a greatest speed above 0.")
        if not self.traced and any(a.input == TURNED for a in axes):
            raise ValueError("the travel since a turn is the only input of a `SinceTurn`.")
        self.axes, self.below, self.dry = axes, below, dry
        self.fields = FIELDS if dry else ()
        self.says = (
            f"What no known effect explains at the {{at}} is modelled as {self.what} that is a function."
        )
        self.id = f"{RESIDUAL}:{'dry:' if dry else ''}{''.join(map(str, axes))}below {below:.6g}"
        self.counts = tuple(a.knots or KNOTS[len(axes)] for a in axes)
        self.external = any(a.input == LOAD for a in axes)
        self.equation = f"{self.what} as a function of {', '.join(a.says for a in axes)}"

    def told_by(self, knots: tuple[int, ...]) -> Residual:
        """The same function with so many values along each input."""
        axes = tuple(replace(a, knots=k) for a, k in zip(self.axes, knots, strict=True))
        return Residual(axes, self.below, self.dry)

    @property
    def size(self) -> int:
        """Number of its values."""
        return math.prod(self.counts)

    @property
    def what(self) -> str:
        """'a force' or 'dry friction'."""
        return "dry friction" if self.dry else "a force"

    @property
    def coupled(self) -> bool:
        """Whether it depends on another joint."""
        return any(a.joint for a in self.axes)

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        torque, unit = float(ctx.torque[ctx.dof(place)]), joint_unit(ctx, place, "N m", "N")
        each = range(self.size)
        return tuple(Param(f"value_{k}", unit, -50 * torque, 50 * torque, 0.1 * torque) for k in each)

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        if self.dry:
            stiff_dry_friction(f, ctx, ctx.dof(place), theta[..., 0])

    def places(self, ctx: Context) -> list[Place]:
        # never searched for: what is left tells where it acts
        return []

    def inputs(self, ctx: Context, place: Place, s: Step) -> list[Array]:
        """Values [...] of every input."""
        return [_value(a.input, ctx, a.place(ctx, place), s) for a in self.axes]

    def basis(self, xp: Any, values: list[Array]) -> list[Array]:
        """The functions [...] whose sum, each times its parameter, is the force: every product of splines."""
        along = [
            splines(xp, a.share(x), count, a.around)
            for a, count, x in zip(self.axes, self.counts, values, strict=True)
        ]
        return along[0] if len(along) == 1 else [one * other for one in along[0] for other in along[1]]

    def against(self, values: dict[str, Array]) -> Array:
        """What its value is multiplied with to be the force [...] on the joint, by the values [...] of inputs: 1, or of
        dry friction the direction against the speed."""
        return -np.sign(values[SPEED]) if self.dry else np.ones_like(values[SPEED])

    def value(self, xp: Any, theta: Array, values: list[Array]) -> Array:
        """The function [...] of inputs [...] within the speeds that were seen."""
        return sum(theta[..., k] * part for k, part in enumerate(self.basis(xp, values)))

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        force, v = self.value(xp, theta, self.inputs(ctx, place, s)), s.v[..., ctx.dof(place)]
        return Forces(dry=force) if self.dry else Forces(joint=self.braking(xp, force, v)), memory

    def braking(self, xp: Any, force: Array, v: Array) -> Array:
        """A force [...] that brakes only, at speeds v [...] beyond those that were seen."""
        fade = xp.clip(1.0 - (xp.abs(v) / self.below - 1.0) / FADES, 0.0, 1.0)
        return xp.where(force * v > 0.0, fade * force, force)

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        return {"values": theta}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        theta = np.asarray(values["values"], dtype=float)
        if theta.shape != (self.size,):
            raise ValueError(f"the residual {self.id} has {self.size} values, not {theta.size}.")
        return theta


def _value(which: str, ctx: Context, place: Place, s: Step) -> Array:
    if which in (ANGLE, WITHIN_TURN):
        return s.q[..., ctx.qadr(place)]
    if which == SPEED:
        return s.v[..., ctx.dof(place)]
    if which == LOAD:
        return s.external(ctx.dof(place))
    drives = driven_by(ctx, place)
    gear = ctx.model.actuator_gear[drives, 0]
    return sum(float(g) * s.f[..., a] for g, a in zip(gear, drives, strict=True))


def driven_by(ctx: Context, place: Place) -> list[int]:
    """Actuators that drive a joint and no other."""
    m = ctx.model
    return [
        a for a in range(m.nu) if is_joint_transmission(m, a) and int(m.actuator_trnid[a, 0]) == place.index
    ]
