"""Dry friction of any law that gives way elastically before it slides."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import ELASTIC, REGISTRY, Effect
from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.effects.friction.dry import Dry
from mpge_jax.diagnosis.effects.step import Array, Forces, Step

DAMPED = 0.3
"""Damping of the bristles to start from, in units of what is critical for the joint's inertia on their spring."""
OWN = 2
"""Parameters beyond those of the law."""
STIFFEST = 0.25
"""Stiffness of the bristles, at most, in units of the joint's inertia over the squared timestep."""
REMEMBERED = 0.2
"""s of motion before a start through which the bristles are followed."""
BENT = (3e-4, 2e-3, 1e-2)
"""How far they bend to start from, in units of the joint's travel."""


class Elastic(Effect):
    """A law of dry friction whose bristles bend before they slide (LuGre; Canudas de Wit et al., 1995).

    They carry what the law says once they slide; until then they are a damped spring. Its compliance and damping are
    two more parameters: the smaller the compliance, the more nearly this is the law itself. Its memory is how far they
    are bent.
    """

    runtime = inertial = True

    def __init__(self, law: Effect) -> None:
        self.law = law
        self.id, self.kinds, self.tier, self.order = law.id + ELASTIC, law.kinds, law.tier + 1, law.order
        self.external, self.confused_with, self.remedy = law.external, law.confused_with, law.remedy
        self.equation = f"s z, dz/dt = v - s |v| z / F, where F is the size of {law.equation}"
        self.says = (
            law.says.removesuffix(".") + "; before it slides it gives way like a spring of {stiffness}."
        )

    def places(self, ctx: Context) -> list[Place]:
        return self.law.places(ctx)

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        own = self.law.params(ctx, place)
        scale = 1e-3 * max(float(ctx.travel[ctx.dof(place)]), 1e-9) / own[0].scale
        unit = joint_unit(ctx, place, "rad/(N m)", "m/N")
        compliance = Param("compliance", unit, 0.0, 1e3 * scale, scale)
        return (*own, compliance, Param("damping_ratio", "1", 0.0, 2.0, 0.1, prior=0.3))

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.concatenate([self.bent(ctx, place, x) for x in self.law.starts(ctx, place)])

    def bent(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """Starts [k, p] from the parameters of the law."""
        slides = max(float(theta[0]), self.law.params(ctx, place)[0].scale)
        travel = max(float(ctx.travel[ctx.dof(place)]), 1e-9)
        return np.array([[*theta, k * travel / slides, DAMPED] for k in BENT])

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        own = {"stiffness": 1.0 / np.maximum(theta[..., -OWN], 1e-12), "damping_ratio": theta[..., -1]}
        return self.law.report(ctx, place, theta[..., :-OWN]) | own

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        own = [1.0 / float(values["stiffness"]), float(values["damping_ratio"])]
        return np.append(self.law.from_report(ctx, place, values), own)

    def units(self, ctx: Context, place: Place) -> dict[str, str]:
        own = {"stiffness": joint_unit(ctx, place, "N m/rad", "N/m"), "damping_ratio": "1"}
        return self.law.units(ctx, place) | own

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return self.law.naming(ctx, place)

    def contrasts(self, ctx: Context, place: Place) -> np.ndarray:
        own = self.law.contrasts(ctx, place)
        return np.concatenate([own, np.zeros((len(own), OWN))], axis=1)

    def remembers(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        return np.full(len(theta), REMEMBERED)

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        return (0.0 * s.q[..., ctx.qadr(place)] + 0.0 * theta[..., 0],)

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        forces, _ = self.law.force(xp, ctx, place, theta[..., :-OWN], s, ())
        # what the engine knows of a law is its first parameter
        slides = xp.maximum(theta[..., 0] if forces.dry is None else forces.dry, 1e-12)
        (before,), v = memory, s.v[..., ctx.dof(place)]
        inertia = s.inertia(ctx.dof(place))
        stiffness = 1.0 / xp.maximum(theta[..., -OWN], s.dt**2 / (STIFFEST * inertia))
        bent = (before + v * s.dt) / (1.0 + stiffness * xp.abs(v) * s.dt / slides)
        damping = 2.0 * theta[..., -1] * xp.sqrt(stiffness * inertia)
        pull = stiffness * bent + damping * (bent - before) / s.dt
        return Forces(joint=-pull if forces.joint is None else forces.joint - pull), (bent,)


@lru_cache(maxsize=64)
def elastic_of(form: str) -> Elastic:
    """The effect of an identifier.

    Raises:
        KeyError: it is none of an elastic form.
    """
    law = dict.get(REGISTRY, form.removesuffix(ELASTIC))
    if not form.endswith(ELASTIC) or not isinstance(law, Dry):
        raise KeyError(form)
    return Elastic(law)


REGISTRY.forms[ELASTIC[1:]] = elastic_of
