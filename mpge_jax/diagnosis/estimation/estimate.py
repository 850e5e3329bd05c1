"""A hypothesis with its parameters, and the weak prior that keeps those that the data do not determine."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from mpge_jax.diagnosis.effects.context import Context, Param
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term

Array = np.ndarray


def nothing() -> Array:
    return np.zeros((0, 0))


@dataclass(frozen=True)
class Fitted:
    """A hypothesis with its parameters.

    Attributes:
        theta: [p]. centre: [p] centre of the weak prior. loss: mean robust loss over windows, prior included.
        information: [p, p] of the data. cov: [p, p] covariance of theta that allows for misfit.
        x: [W] relative chi^2 of each window.
    """

    hypothesis: Hypothesis
    theta: Array
    centre: Array
    loss: float = np.inf
    information: Array = field(default_factory=nothing)
    cov: Array = field(default_factory=nothing)
    x: Array = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def start(ctx: Context, parts: Mapping[Term, Array]) -> Fitted:
        """The effects of `parts`, each with its parameters there, to begin a fit with."""
        h = Hypothesis.of(*parts)
        theta = h.gather(ctx, parts)
        return Fitted(h, theta, theta)

    def exchanged(self, ctx: Context, gone: Collection[Term], come: Mapping[Term, Array]) -> Fitted:
        """The same with other effects, or parameters, in the place of some, to begin a fit with."""
        kept = {t: x for t, x in self.hypothesis.split(ctx, self.theta).items() if t not in gone}
        return Fitted.start(ctx, {**kept, **come})

    def of_terms(self, ctx: Context, h: Hypothesis) -> Fitted:
        """Some of its effects with the same parameters, not fitted again."""
        theta, centre = (h.gather(ctx, self.hypothesis.split(ctx, x)) for x in (self.theta, self.centre))
        return Fitted(h, theta, centre)

    def beside_nothing(self, ctx: Context, *terms: Term) -> Fitted:
        """The same with further effects at which nothing acts yet, to be fitted."""
        h = Hypothesis.of(*self.hypothesis.terms, *terms)
        null = {t: t.effect.null(ctx, t.place) for t in terms}
        theta, centre = (
            h.gather(ctx, self.hypothesis.split(ctx, x) | null) for x in (self.theta, self.centre)
        )
        return Fitted(h, theta, centre)

    def directions(self, ctx: Context) -> int:
        """Number of parameter combinations that the data identify better than their prior does."""
        if not self.information.size or not self.theta.size:
            return 0
        scale = prior_widths(self.hypothesis.params(ctx))
        values = np.linalg.eigvalsh(self.information * scale[:, None] * scale[None, :])
        return int((values > 16.0).sum())

    def unlikely(self, ctx: Context) -> float:
        """Minus the logarithm of how likely what is `known` beforehand would be, against being as the model has it."""
        nulls = {t: t.effect.null(ctx, t.place) for t in self.hypothesis.terms}
        off = self.theta - self.hypothesis.gather(ctx, nulls)
        params = self.hypothesis.params(ctx)
        return 0.5 * float(sum((x / p.prior) ** 2 for x, p in zip(off, params, strict=True) if p.known))


NOTHING = Fitted(Hypothesis(), np.zeros(0), np.zeros(0))
"""The nominal model."""


def prior_widths(params: list[Param], values: int = 1) -> Array:
    """Deviations [p] of the prior, as they count in a loss that divides by the number of `values` of a window."""
    return np.array([(p.prior or 30.0 * p.scale) * (np.sqrt(values) if p.known else 1.0) for p in params])


def bounds(params: list[Param]) -> tuple[Array, Array]:
    return np.array([p.low for p in params]), np.array([p.high for p in params])


def prior_loss(params: list[Param], theta: Array, centre: Array, windows: int, values: int) -> float:
    if not params:
        return 0.0
    return float((((theta - centre) / prior_widths(params, values)) ** 2).sum()) / max(windows, 1)
