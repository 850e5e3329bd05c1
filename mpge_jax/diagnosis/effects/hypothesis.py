"""A hypothesis: which effects act where, with one flat parameter vector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.effects.base import REGISTRY, Effect
from mpge_jax.diagnosis.effects.closer import Closer
from mpge_jax.diagnosis.effects.context import Context, Param, Place

Array = np.ndarray


@dataclass(frozen=True)
class Term:
    """One effect at one place."""

    id: str
    place: Place

    @property
    def effect(self) -> Effect:
        return REGISTRY[self.id]

    @property
    def name(self) -> str:
        """The identifier of the vocabulary, without the form."""
        return self.id.partition(":")[0]

    @property
    def plain(self) -> str:
        """The identifier of the effect of which this is another form, else its own."""
        effect = self.effect
        return effect.plain.id if isinstance(effect, Closer) else effect.form_of or self.id

    @property
    def turn(self) -> tuple[int, str, str, int]:
        """Terms act in the order of this: a factor of a given mass comes before a payload that is added to it."""
        return self.effect.order, self.id, self.place.kind, self.place.index

    def params(self, ctx: Context) -> tuple[Param, ...]:
        return self.effect.params(ctx, self.place)

    def __str__(self) -> str:
        return f"{self.name}@{self.place.name}"


@dataclass(frozen=True)
class Hypothesis:
    """Terms, kept in one order so that equal sets are equal."""

    terms: tuple[Term, ...] = ()

    @staticmethod
    def of(*terms: Term) -> Hypothesis:
        return Hypothesis(tuple(sorted(terms, key=lambda t: t.turn)))

    @property
    def rugged(self) -> bool:
        """Whether parts of its drives strike each other."""
        return any(t.effect.rugged for t in self.terms)

    @property
    def named(self) -> tuple[Term, ...]:
        """Its terms but for those that correct what is given."""
        return tuple(t for t in self.terms if t.effect.named)

    def params(self, ctx: Context) -> list[Param]:
        return [p for t in self.terms for p in t.params(ctx)]

    def slices(self, ctx: Context) -> list[slice]:
        out, start = [], 0
        for t in self.terms:
            n = len(t.params(ctx))
            out.append(slice(start, start + n))
            start += n
        return out

    def with_term(self, term: Term) -> Hypothesis:
        return Hypothesis.of(*self.terms, term)

    def without(self, term: Term) -> Hypothesis:
        return Hypothesis.of(*(t for t in self.terms if t != term))

    def gather(self, ctx: Context, parts: Mapping[Term, Array]) -> Array:
        """Flat parameters from each term's own."""
        rows = [np.asarray(parts[t], dtype=float).reshape(-1) for t in self.terms]
        return np.concatenate(rows) if rows else np.zeros(0)

    def split(self, ctx: Context, theta: Array) -> dict[Term, Array]:
        return {t: theta[s] for t, s in zip(self.terms, self.slices(ctx), strict=True)}

    def __str__(self) -> str:
        return " + ".join(map(str, self.terms)) or "nominal"
