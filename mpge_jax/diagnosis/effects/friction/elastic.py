"""Dry friction of any law that gives way elastically before it slides."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect
from mpge_jax.diagnosis.effects.closer import Closer, closer_form
from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.effects.friction.dry import ELASTIC
from mpge_jax.diagnosis.effects.step import Array, Fields, Forces, Step

DAMPED = 0.3
"""Damping of the bristles to start from, in units of what is critical for the joint's inertia on their spring."""
STIFFEST = 0.25
"""Stiffness of the bristles, at most, in units of the joint's inertia over the squared timestep."""
REMEMBERED = 0.2
"""s of motion before a start through which the bristles are followed."""
BENT = (3e-4, 2e-3, 1e-2)
"""How far they bend to start from, in units of the joint's travel."""


@closer_form
class Elastic(Closer):
    """A law of dry friction whose bristles bend before they slide (LuGre; Canudas de Wit et al., 1995).

    They carry what the law says once they slide; until then they are a damped spring. Its compliance and damping are
    two more parameters: the smaller the compliance, the more nearly this is the law itself. Its memory is how far they
    are bent.
    """

    ending, further = ELASTIC, 2
    adds = "; before it slides it gives way like a spring of {stiffness}."
    runtime = inertial = True

    def __init__(self, plain: Effect) -> None:
        super().__init__(plain)
        self.equation = f"s z, dz/dt = v - s |v| z / F, where F is the size of {plain.equation}"
        self.fields = ()

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        """Its bristles are all that rubs."""

    def own(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        scale = 1e-3 * _travel(ctx, place) / self.plain.params(ctx, place)[0].scale
        compliance = Param("compliance", joint_unit(ctx, place, "rad/(N m)", "m/N"), 0.0, 1e3 * scale, scale)
        return compliance, Param("damping_ratio", "1", 0.0, 2.0, 0.1, prior=0.3)

    def starts_from(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        slides = max(float(theta[0]), self.plain.params(ctx, place)[0].scale)
        return np.array([[*theta, k * _travel(ctx, place) / slides, DAMPED] for k in BENT])

    def report_own(self, ctx: Context, place: Place, own: np.ndarray) -> dict[str, np.ndarray]:
        return {"stiffness": 1.0 / np.maximum(own[..., 0], 1e-12), "damping_ratio": own[..., 1]}

    def own_from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> list[float]:
        return [1.0 / float(values["stiffness"]), float(values["damping_ratio"])]

    def own_units(self, ctx: Context, place: Place) -> dict[str, str]:
        return {"stiffness": joint_unit(ctx, place, "N m/rad", "N/m"), "damping_ratio": "1"}

    def remembers(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        return np.full(len(theta), REMEMBERED)

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        return (0.0 * s.q[..., ctx.qadr(place)] + 0.0 * theta[..., 0],)

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        forces, _ = self.plain.force(xp, ctx, place, theta[..., : -self.further], s, ())
        # what the engine knows of a law is its first parameter
        slides = xp.maximum(theta[..., 0] if forces.dry is None else forces.dry, 1e-12)
        (before,), v = memory, s.v[..., ctx.dof(place)]
        inertia = s.inertia(ctx.dof(place))
        stiffness = 1.0 / xp.maximum(theta[..., -2], s.dt**2 / (STIFFEST * inertia))
        bent = (before + v * s.dt) / (1.0 + stiffness * xp.abs(v) * s.dt / slides)
        damping = 2.0 * theta[..., -1] * xp.sqrt(stiffness * inertia)
        pull = stiffness * bent + damping * (bent - before) / s.dt
        return Forces(joint=-pull if forces.joint is None else forces.joint - pull), (bent,)


def _travel(ctx: Context, place: Place) -> float:
    return max(float(ctx.travel[ctx.dof(place)]), 1e-9)
