"""Closer forms: an effect without one of its idealisations, under the same name and with more parameters."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.base import REGISTRY, Effect
from mpge_jax.diagnosis.effects.context import Context, Param, Place
from mpge_jax.diagnosis.effects.step import Array, Fields

LEAST = 1e-3
"""The least of what the model may have too much of that a closer form has, in its scale."""


class Closer(Effect):
    """A closer form of an effect. It is no candidate by itself: it is asked for where the plain one stands.

    Its parameters are those of the plain one and `further` ones of its own, of which the first vanishes where the plain
    one is as good.
    """

    ending: str = ""
    """How its identifier ends, after that of the plain one."""
    adds: str = ""
    """What it adds to the plain one's sentence."""
    further = 1
    """How many parameters are its own."""
    beside: str = ""
    """An effect of the same place without which it may not show: where the place has none, both are tried together."""
    imitated_by: str = ""
    """An effect of the same place that makes the plain one look like it: it has to be better than the two."""

    def __init__(self, plain: Effect) -> None:
        self.plain = plain
        self.id, self.kinds, self.tier, self.order = (
            plain.id + self.ending,
            plain.kinds,
            plain.tier + 1,
            plain.order,
        )
        self.external, self.confused_with, self.remedy = plain.external, plain.confused_with, plain.remedy
        self.fields = plain.fields
        self.says = plain.says.removesuffix(".") + self.adds

    def fits(self, ctx: Context, place: Place) -> bool:
        """Whether it can act where the plain one stands."""
        return True

    def own(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        """Its own parameters."""
        raise NotImplementedError

    def starts_from(self, ctx: Context, place: Place, theta: np.ndarray) -> np.ndarray:
        """Starts [k, p] from the parameters of the plain one."""
        raise NotImplementedError

    def places(self, ctx: Context) -> list[Place]:
        return self.plain.places(ctx)

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        plain = self.plain.params(ctx, place)
        if self.plain.says_less and plain[0].low < 0.0:
            plain = (replace(plain[0], low=LEAST * plain[0].scale), *plain[1:])
        return (*plain, *self.own(ctx, place))

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        return np.concatenate([self.starts_from(ctx, place, x) for x in self.plain.starts(ctx, place)])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        self.plain.model(f, ctx, place, theta[..., : -self.further])

    def naming(self, ctx: Context, place: Place) -> list[int]:
        return self.plain.naming(ctx, place)

    def contrasts(self, ctx: Context, place: Place) -> np.ndarray:
        plain = self.plain.contrasts(ctx, place)
        return np.concatenate([plain, np.zeros((len(plain), self.further))], axis=1)

    def null(self, ctx: Context, place: Place) -> np.ndarray:
        return np.append(self.plain.null(ctx, place), np.zeros(self.further))

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        plain, own = theta[..., : -self.further], theta[..., -self.further :]
        return self.plain.report(ctx, place, plain) | self.report_own(ctx, place, own)

    def report_own(self, ctx: Context, place: Place, own: np.ndarray) -> dict[str, np.ndarray]:
        """Its own parameters [..., further], as the report names them."""
        return {p.name: own[..., i] for i, p in enumerate(self.own(ctx, place))}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        return np.append(self.plain.from_report(ctx, place, values), self.own_from_report(ctx, place, values))

    def own_from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> list[float]:
        """Inverse of `report_own`."""
        return [float(values[p.name]) for p in self.own(ctx, place)]

    def units(self, ctx: Context, place: Place) -> dict[str, str]:
        return self.plain.units(ctx, place) | self.own_units(ctx, place)

    def own_units(self, ctx: Context, place: Place) -> dict[str, str]:
        """Units of `report_own`."""
        return {p.name: p.unit for p in self.own(ctx, place)}


def closer_form(made: type[Closer]) -> type[Closer]:
    """Class decorator: effects whose `closer` has the ending of this form have it, under their identifier with that."""

    @lru_cache(maxsize=64)
    def of(form: str) -> Closer:
        plain = dict.get(REGISTRY, form.removesuffix(made.ending))
        if plain is None or made.ending not in plain.closer:
            raise KeyError(form)
        return made(plain)

    REGISTRY.forms[made.ending[1:]] = of
    return made
