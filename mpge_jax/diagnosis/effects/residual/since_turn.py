"""Force that no effect explains, as a function of how far a joint has moved since it turned: hysteresis."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.context import Context, Place
from mpge_jax.diagnosis.effects.residual.axis import TURNED, Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.effects.step import Array, Forces, Step

REMEMBERED = 10.0
"""s of motion before a start through which the travel is followed, or as many as are kept."""


class SinceTurn(Residual):
    """A residual whose only input is the travel since the joint turned (the stop operator of Prandtl and Ishlinskii;
    Brokate and Sprekels, Hysteresis and Phase Transitions, 1996). That is its memory; amid its range to begin with."""

    traced = True

    def __init__(self, axis: Axis, below: float) -> None:
        if axis.input != TURNED:
            raise ValueError(f"this residual depends on {TURNED}, not on {axis}.")
        super().__init__((axis,), below)

    def told_by(self, knots: tuple[int, ...]) -> SinceTurn:
        (axis,), (count,) = self.axes, knots
        return SinceTurn(replace(axis, knots=count), self.below)

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        return (0.0 * s.q[..., ctx.qadr(place)] + 0.0 * theta[..., 0],)

    def remembers(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        return np.full(len(theta), REMEMBERED)

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        (axis,), (before,), v = self.axes, memory, s.v[..., ctx.dof(place)]
        travel = xp.clip(before + v * s.dt, axis.low, axis.high)
        return Forces(joint=self.braking(xp, self.value(xp, theta, [travel]), v)), (travel,)

    def along(self, ctx: Context, place: Place, theta: np.ndarray, q: np.ndarray) -> np.ndarray:
        (axis,) = self.axes
        force: np.ndarray = self.value(np, theta, [travelled(q[:, ctx.qadr(place)], axis.high)])
        return force


def travelled(q: np.ndarray, most: float) -> np.ndarray:
    """Travel [T] since a joint at positions q [T] turned, between -`most` and `most`; 0 at first."""
    travel, out = 0.0, []
    for moved in np.diff(q, prepend=q[:1]).tolist():
        travel = min(max(travel + moved, -most), most)
        out.append(travel)
    return np.array(out)
