"""Dry friction that a joint reaches only through a gap and a spring."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, joint_unit
from mpge_jax.diagnosis.effects.friction.scales import torque_param
from mpge_jax.diagnosis.effects.step import Array, Forces, Step


@register
class FrictionBehindGap(Effect):
    """A part with dry friction hangs on the joint by a spring with free travel: after a reversal the spring unloads,
    the gap is crossed, and the spring loads again until the part slides (a stop operator behind a dead zone; without a
    gap, elastic pre-sliding: Dahl, 1968).

    Its memory is how far the joint is ahead of the part, which slides as soon as that is more than half the gap and the
    spring's longest travel.
    """

    id, kinds, tier, runtime = "coulomb_friction:behind_gap", ("joint",), 3, True
    traced, simulated = True, False
    equation = "-Fc sgn(z) clip((|z| - gap / 2) k / Fc, 0, 1), dz = dq while |z| < gap / 2 + Fc / k"
    says = (
        "The {at} has dry friction of {torque} that the model lacks, reached through a free travel of {gap} and a "
        "spring of {stiffness}."
    )
    remedy = "reverse the joint slowly many times, by less and by more than its free travel"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        travel = max(float(ctx.travel[ctx.dof(place)]), 1e-9)
        unit = joint_unit(ctx, place, "rad", "m")
        return (
            torque_param(ctx, place, "torque"),
            Param("yield", unit, 1e-4 * travel, travel, 0.02 * travel),
            Param("gap", unit, 0.0, travel, 0.02 * travel),
        )

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        torque, travel = self.params(ctx, place)[0].scale, 50.0 * self.params(ctx, place)[2].scale
        shares = [(y, g) for y in (0.005, 0.02, 0.06) for g in (0.0, 0.02, 0.06)]
        return np.array([[torque, y * travel, g * travel] for y, g in shares])

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        torque, most, gap = (theta[..., i] for i in range(3))
        return {"torque": torque, "stiffness": torque / most, "gap": gap}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        torque, stiffness, gap = (float(values[k]) for k in ("torque", "stiffness", "gap"))
        return np.array([torque, torque / stiffness, gap])

    def units(self, ctx: Context, place: Place) -> dict[str, str]:
        torque, _, gap = (p.unit for p in self.params(ctx, place))
        return {"torque": torque, "stiffness": joint_unit(ctx, place, "N m/rad", "N/m"), "gap": gap}

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        return 0.0 * s.q[..., ctx.qadr(place)]

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        most = 0.5 * theta[..., 2] + theta[..., 1]
        ahead = xp.clip(memory + s.v[..., ctx.dof(place)] * s.dt, -most, most)
        return Forces(joint=_pull(xp, theta, ahead)), ahead

    def along(self, ctx: Context, place: Place, theta: np.ndarray, q: np.ndarray) -> np.ndarray:
        most, z, ahead = float(0.5 * theta[2] + theta[1]), 0.0, [0.0]
        for before, now in pairwise(q[:, ctx.qadr(place)].tolist()):
            z = min(max(z + now - before, -most), most)
            ahead.append(z)
        return _pull(np, theta, np.array(ahead))


def _pull(xp: Any, theta: Array, ahead: Array) -> Array:
    """Force [...] on a joint that is `ahead` of the part."""
    share = xp.clip((xp.abs(ahead) - 0.5 * theta[..., 2]) / theta[..., 1], 0.0, 1.0)
    return -theta[..., 0] * xp.sign(ahead) * share
