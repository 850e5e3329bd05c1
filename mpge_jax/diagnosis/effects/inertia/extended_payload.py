"""A payload that is no point."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.base import Effect
from mpge_jax.diagnosis.effects.closer import Closer, closer_form
from mpge_jax.diagnosis.effects.context import Context, Param, Place
from mpge_jax.diagnosis.effects.inertia.masses import EXTENDED, PayloadMass
from mpge_jax.diagnosis.effects.step import Array, Fields

SPREAD = (0.2, 0.6)
"""Radii of gyration to start from, in units of the body's size."""


@closer_form
class ExtendedPayload(Closer):
    """A payload that resists turning about its own centre as well, alike about all axes."""

    ending = EXTENDED
    adds = ", spread over a radius of gyration of {gyration_radius}."
    set_const = True
    equation = "a mass at a position in the body's frame, with its own inertia m r^2 about every axis"

    def __init__(self, plain: Effect) -> None:
        assert isinstance(plain, PayloadMass)
        super().__init__(plain)
        self.shape = plain.shape

    def own(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        _, size = self.shape(ctx, place)
        return (Param("gyration_radius", "m", 0.0, 5.0 * size, 0.1 * size),)

    def starts_from(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        _, size = self.shape(ctx, place)
        return np.array([[*theta, k * size] for k in SPREAD])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        super().model(f, ctx, place, theta)
        own = theta[..., 0] * theta[..., -1] ** 2
        f.add("body_inertia", (place.index,), f.xp.stack([own] * 3, -1))
