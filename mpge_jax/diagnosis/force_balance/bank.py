"""All candidate effects as columns of one regression of forces, at each of their starting values."""

from __future__ import annotations

from collections.abc import Collection, Iterable
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
    """The regression, and which columns are whose.

    Attributes:
        nominal: [N, nu] force that the motion needs in the model as given. made: [P, N, nu] the columns.
    """

    balance: Balance
    nominal: Array
    made: Array
    normal: Normal
    entries: list[Entry]

    @staticmethod
    def of(b: Balance, terms: Iterable[Term], known: Iterable[tuple[Term, Array]] = ()) -> Bank:
        """Every term at every start, and others at values that are known."""
        starts = [(t, x) for t in terms for x in t.effect.starts(b.ctx, t.place)]
        nominal = b.predicted({})
        return _joined(b, nominal, np.zeros((0, *nominal.shape)), [], [*starts, *known])

    def near(self, starts: Iterable[tuple[Term, Array]]) -> Bank:
        """The same with further starting values."""
        starts = list(starts)
        return _joined(self.balance, self.nominal, self.made, self.entries, starts) if starts else self

    def columns(self, entries: Iterable[Entry]) -> list[int]:
        return [c for e in entries for c in e.columns]

    def single(self, terms: Collection[Term]) -> dict[Term, Array]:
        """Columns [1, N, nu] of those of the effects that have one parameter."""
        ones = (e for e in self.entries if len(e.columns) == 1 and e.term in terms)
        return {e.term: self.made[list(e.columns)] for e in ones}

    def parts(self, entries: Iterable[Entry], coefficients: Array) -> dict[Term, Array]:
        """Parameters by term of a solution."""
        out, at = {}, 0
        for e in entries:
            out[e.term] = e.origin + coefficients[at : at + len(e.columns)]
            at += len(e.columns)
        return out


def _joined(
    b: Balance, nominal: Array, made: Array, entries: list[Entry], starts: list[tuple[Term, Array]]
) -> Bank:
    entries, at = list(entries), len(made)
    changes = [b.changes(*s) for s in starts]
    # filters take all columns at once
    seen = b.as_measured(np.concatenate(changes)) if changes else made
    columns, first = [made], 0
    for (term, start), own in zip(starts, changes, strict=True):
        change, x = seen[first], seen[first + 1 : first + len(own)]
        entries.append(Entry(term, _origin(b.ctx, term, start, x, change), range(at, at + len(x))))
        columns.append(x)
        at, first = at + len(x), first + len(own)
    made = np.concatenate(columns)
    params = [list(e.term.params(b.ctx)) for e in entries]
    prior = np.concatenate([np.zeros(0), *(prior_widths(p) ** -2.0 for p in params)])
    limits = [np.array(bounds(p)) - e.origin for p, e in zip(params, entries, strict=True)]
    low, high = np.concatenate([np.zeros((2, 0)), *limits], axis=1)
    normal = Normal.of(made, b.telling - nominal, b.block, b.fold, prior, low, high)
    return Bank(b, nominal, made, normal, entries)


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
