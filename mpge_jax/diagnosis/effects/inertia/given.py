"""Given masses and inertias, which nobody knows exactly."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import REGISTRY, Effect
from mpge_jax.diagnosis.effects.context import Context, Param, Place, default_places
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.step import Array, Fields

GIVEN = "given_inertias"
MOST = 3.0
"""Deviations from what the model says, at most."""


class GivenInertias(Effect):
    """Every body's mass and inertia are what the model says but for `share` (a standard deviation), no more than three
    of it."""

    kinds, vanishes_at, named = ("world",), 1.0, False
    equation = "every mass and every inertia times a factor of its own, near one"
    fields = ("body_mass", "body_inertia", "body_gravcomp")
    set_const = True

    def __init__(self, share: float) -> None:
        self.id, self.share = f"{GIVEN}:{share:g}", share

    def bodies(self, ctx: Context) -> list[Place]:
        return default_places(ctx, "body")

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        low, high = 1.0 - MOST * self.share, 1.0 + MOST * self.share
        return tuple(
            Param(f"{what} of {body.name}", "1", low, high, self.share, prior=self.share, known=True)
            for body in self.bodies(ctx)
            for what in ("mass", "inertia")
        )

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        """Factors of the bodies, in the order of `bodies`."""
        return {"mass": theta[..., 0::2], "inertia": theta[..., 1::2]}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        pairs = [np.asarray(values[name], dtype=float) for name in ("mass", "inertia")]
        return np.stack([x.reshape(len(self.bodies(ctx))) for x in pairs], -1).reshape(-1)

    def units(self, ctx: Context, place: Place) -> dict[str, str]:
        return {"mass": "1", "inertia": "1"}

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.ones((1, 2 * len(self.bodies(ctx))))

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return list(range(2 * len(self.bodies(ctx))))

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        for k, body in enumerate(self.bodies(ctx)):
            mass, inertia = theta[..., 2 * k], theta[..., 2 * k + 1]
            f.scale("body_mass", (body.index,), mass)
            f.scale("body_inertia", (body.index,), inertia[..., None])
            if ctx.model.body_gravcomp[body.index]:
                # a compensation of gravity knows the nominal masses only
                f.scale("body_gravcomp", (body.index,), 1.0 / mass)


def given_inertias(share: float) -> Term:
    """The term of them all."""
    return Term(f"{GIVEN}:{share:g}", Place("world", "world", 0))


@lru_cache
def _of_share(form: str) -> GivenInertias:
    return GivenInertias(float(form.partition(":")[2]))


REGISTRY.families[GIVEN] = _of_share
