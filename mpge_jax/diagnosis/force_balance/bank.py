"""All candidate effects as columns of one regression of forces, at each of their starting values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import bounds, prior_widths
from mpge_jax.diagnosis.force_balance.balance import Balance
from mpge_jax.diagnosis.force_balance.gram import Normal

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Entry:
    """One effect near one value of its parameters, as if linear.

    Attributes:
        origin: [p] parameters at which the linearised effect is nothing. columns: its numbers in the regression.
    """

    term: Term
    origin: Array
    columns: range


@dataclass(frozen=True)
class Bank:
    """The regression, and which columns are whose."""

    normal: Normal
    entries: list[Entry]

    @staticmethod
    def of(b: Balance, terms: Iterable[Term]) -> Bank:
        """Every term at every start."""
        nominal = b.predicted({})
        entries: list[Entry] = []
        columns: list[Array] = []
        prior, limits = [np.zeros(0)], [np.zeros((2, 0))]
        for term in terms:
            params = list(term.params(b.ctx))
            for start in term.effect.starts(b.ctx, term.place):
                here = b.predicted({term: start})
                x, change = b.columns({term: start}, term, here), here - nominal
                origin = _origin(b.ctx, term, start, x, change)
                entries.append(Entry(term, origin, range(len(columns), len(columns) + len(params))))
                columns += list(x)
                prior.append(prior_widths(params) ** -2.0)
                limits.append(np.array(bounds(params)) - origin)
        made = np.array(columns).reshape(-1, *nominal.shape)
        low, high = np.concatenate(limits, axis=1)
        normal = Normal.of(made, b.measured - nominal, b.block, b.fold, np.concatenate(prior), low, high)
        return Bank(normal, entries)

    def columns(self, entries: Iterable[Entry]) -> list[int]:
        return [c for e in entries for c in e.columns]

    def parts(self, entries: Iterable[Entry], coefficients: Array) -> dict[Term, Array]:
        """Parameters by term of a solution."""
        out, at = {}, 0
        for e in entries:
            out[e.term] = e.origin + coefficients[at : at + len(e.columns)]
            at += len(e.columns)
        return out


def _origin(ctx: Context, term: Term, start: Array, columns: Array, change: Array) -> Array:
    """Where the linearised effect is nothing: the parameters that make it vanish at their null, those that only shape
    it at their start. Which ones do is told by what reproduces the effect at its start."""
    null, naming = term.effect.null(ctx, term.place), term.effect.naming(ctx, term.place)
    everything = list(range(len(start)))
    best, least = null, np.inf
    for vanishing in (naming, everything, everything[:-1]):
        origin = start.copy()
        origin[vanishing] = null[vanishing]
        wrong = float(((np.tensordot(start - origin, columns, 1) - change) ** 2).sum())
        if wrong < 0.99 * least:
            best, least = origin, wrong
    return best


def hypothesis_of(entries: Iterable[Entry]) -> Hypothesis:
    return Hypothesis.of(*(e.term for e in entries))
