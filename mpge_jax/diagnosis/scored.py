"""Fits with their losses window by window, and how two of them compare."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.evidence import rare, standard_error
from mpge_jax.diagnosis.fitted import Fitted
from mpge_jax.diagnosis.hypothesis import Term
from mpge_jax.diagnosis.screen import ELABORATE

Array = np.ndarray
FEW = 3
"""Candidates that are fitted further however far they lag behind the best."""
TIE = 0.03
"""Differences of relative loss below this are ties, whatever their standard error."""


@dataclass
class Scored:
    """A fit with its loss on every window, training windows first. factor: by which the whiteners were tempered."""

    fit: Fitted
    train: Array
    held: Array
    directions: int
    tier: int
    factor: float = 1.0

    @property
    def losses(self) -> Array:
        return np.concatenate([self.train, self.held])

    @property
    def complexity(self) -> tuple[float, ...]:
        return (self.directions + 0.75 * self.tier, self.fit.theta.size)


@dataclass
class Rival:
    """An alternative to one term: the losses tell by how much it is worse.

    Attributes:
        term: what replaces it. fit: the whole hypothesis with it. margin, error: mean difference of the losses and
        its standard error. tied: whether the data cannot tell the two apart. better: whether it predicts clearly
        better than the term.
    """

    term: Term
    fit: Fitted
    margin: float
    error: float
    why_not: str
    tied: bool = False
    better: bool = False


def hopeful(fits: list[Fitted], before: float) -> list[Fitted]:
    """Fits that take away at least half as much of the loss `before` them as the best does, and the best few; best
    first."""
    ranked = sorted(fits, key=lambda f: f.loss)
    limit = 0.5 * (before + ranked[0].loss) if ranked else before
    return [f for i, f in enumerate(ranked) if i < FEW or f.loss < limit]


def with_simpler(screened: list[Fitted], keep: int) -> list[Fitted]:
    """The best `keep`, and the plain form of every elaborate friction among them."""
    top = screened[:keep]
    chosen = {f.hypothesis for f in top}
    plain = ("coulomb_friction", "viscous_damping")
    places = {t.place for f in top for t in f.hypothesis.terms if t.id in ELABORATE}
    for f in screened[keep:]:
        if f.hypothesis not in chosen and any(
            t.id in plain and t.place in places for t in f.hypothesis.terms
        ):
            top.append(f)
    return top


def clearly_worse(a: Scored, best: Scored) -> bool:
    """Whether `a` loses to the best by more than two standard errors (paired by window) and more than a tie, or misses
    what acts rarely."""
    d = a.losses - best.losses
    return bool(d.mean() > max(2.0 * standard_error(d), TIE)) or misses(a, best)


def misses(a: Scored, best: Scored) -> bool:
    """Whether `a` leaves what acts rarely and `best` explains."""
    return best.factor == 1.0 and rare(a.losses, best.losses, best.train.size)
