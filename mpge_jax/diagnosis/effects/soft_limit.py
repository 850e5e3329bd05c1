"""A drive that nears its largest force by and by: iron saturates, a supply gives way."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.actuator import SOFT, in_place, replaceable
from mpge_jax.diagnosis.effects.closer import Closer, closer_form
from mpge_jax.diagnosis.effects.context import Context, Param, Place
from mpge_jax.diagnosis.effects.step import Array, Forces, Step

HARD = 0.02
"""Softness below which a knee is as good as sharp."""
KNEES = (0.1, 0.3)
"""Softness to start from."""


@closer_form
class SoftLimit(Closer):
    """A torque limit with a soft knee: a p-norm in place of the sharp one, whose p is one over the softness."""

    ending = SOFT
    adds = ", and nears that by and by (softness {softness}; that of a sharp limit is 0)."
    equation = "tau / (1 + |tau / limit|^(1/s))^s"
    runtime = True

    def __init__(self, plain: Any) -> None:
        super().__init__(plain)
        self.side = plain.side

    def fits(self, ctx: Context, place: Place) -> bool:
        return replaceable(ctx, place)

    def own(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("softness", "1", 0.0, 1.0, 0.1),)

    def starts_from(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        return np.array([[*theta, softness] for softness in KNEES])

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        a = place.index
        free, limit, softness = s.f_free[..., a], xp.maximum(theta[..., 0], 1e-12), theta[..., 1]
        soft = free / _norm(xp, xp.abs(free) / limit, xp.maximum(softness, HARD))
        clipped = xp.minimum(xp.maximum(soft, s.force_low[..., a]), s.force_high[..., a])
        return in_place(ctx, place, s, clipped), memory


def _norm(xp: Any, x: Array, softness: Array) -> Array:
    """(1 + x^(1/s))^s without large powers, for x >= 0."""
    most, least = xp.maximum(x, 1.0), xp.minimum(x, 1.0)
    return most * (1.0 + (least / most) ** (1.0 / softness)) ** softness
