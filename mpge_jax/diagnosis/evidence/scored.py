"""Fits with their losses window by window, and how two of them compare."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mpge_jax.diagnosis.effects.candidates import PLAIN
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.screening import ELABORATE
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt, log_ratio, stand_out
from mpge_jax.diagnosis.thresholds import AT_NOISE, FAMILIES, HALF_AS_GOOD, INDIRECT, LOUD

Array = np.ndarray


@dataclass
class Scored:
    """A fit with its loss on every window, training windows first.

    Attributes:
        factor: by which the whiteners were tempered. each: [W, joints] losses of every joint by itself; empty: of one.
        unlikely: minus the logarithm of how likely what is known beforehand would be (`Fitted.unlikely`).
    """

    fit: Fitted
    train: Array
    held: Array
    directions: int
    tier: int
    factor: float = 1.0
    each: Array = field(default_factory=lambda: np.zeros((0, 0)))
    unlikely: float = 0.0

    @property
    def losses(self) -> Array:
        return np.concatenate([self.train, self.held])

    @property
    def by_joint(self) -> Array:
        """[W, joints] losses; what one joint of many lacks drowns in the mean over all."""
        return self.each if self.each.size else self.losses[:, None]

    @property
    def noise_alone(self) -> bool:
        """Whether windows show nothing but noise of the size that it was taken to have, at any joint."""
        quiet = self.factor == 1.0 and float(self.losses.mean()) <= AT_NOISE
        quiet = quiet and float(self.by_joint.mean(0).max()) <= LOUD
        return quiet and not any(stand_out(x).any() for x in (self.losses, *self.by_joint.T))

    @property
    def complexity(self) -> tuple[float, ...]:
        return (self.directions + INDIRECT * self.tier, self.fit.theta.size)


@dataclass(frozen=True)
class Reached:
    """Where a search is.

    Attributes:
        fit: what was accepted so far. last: what was ranked beside its last effect.
    """

    fit: Fitted = NOTHING
    last: tuple[Scored, ...] = ()


@dataclass
class Rival:
    """An alternative to one term: the losses tell by how much it is worse.

    Attributes:
        term: what replaces it. fit: the whole hypothesis with it. margin: logarithm of the likelihood ratio by which
        it is worse. tied: whether the data cannot tell the two apart. better: whether it predicts clearly
        better than the term. beside: the same effect at other places, where only all of them replace the term.
    """

    term: Term
    fit: Fitted
    margin: float
    why_not: str
    tied: bool = False
    better: bool = False
    beside: tuple[Term, ...] = ()

    @property
    def at(self) -> str:
        """The places of what replaces the term."""
        return ", ".join(t.place.name for t in (self.term, *self.beside))


def family(term: Term) -> tuple[str, Place]:
    """What acts in much the same way: friction of any law at one place, else one effect at one place."""
    return ("friction" if "friction" in term.id or "damping" in term.id else term.name, term.place)


def hopeful(fits: list[Fitted], before: float) -> list[Fitted]:
    """Fits that take away at least half as much of the loss `before` them as the best does, the best few families, and
    the plain forms of elaborate frictions among them; best first. What adds no physics takes no family's place."""
    ranked = sorted(fits, key=lambda f: f.loss)
    common = _common(ranked)
    limit = before - HALF_AS_GOOD * (before - ranked[0].loss) if ranked else before
    kept: list[Fitted] = []
    families: set[frozenset[tuple[str, Place]]] = set()
    for f in ranked:
        kind = frozenset(map(family, f.hypothesis.terms))
        if f.loss < limit or (kind not in families and len(families) < FAMILIES):
            kept.append(f)
            if set(f.hypothesis.named) - common:
                families.add(kind)
    rest = [f for f in ranked if all(f is not k for k in kept)]
    return sorted(with_simpler([*kept, *rest], len(kept)), key=lambda f: f.loss)


def with_simpler(screened: list[Fitted], keep: int) -> list[Fitted]:
    """The best `keep`, and the plain form of every elaborate friction among them."""
    top = screened[:keep]
    chosen = {f.hypothesis for f in top}
    common = _common(screened)
    places = {t.place for f in top for t in set(f.hypothesis.terms) - common if t.plain in ELABORATE}
    for f in screened[keep:]:
        own = set(f.hypothesis.terms) - common
        if f.hypothesis not in chosen and any(t.id in PLAIN and t.place in places for t in own):
            top.append(f)
    return top


def _common(fits: list[Fitted]) -> set[Term]:
    """Terms that all have, as what the search has found so far."""
    return set.intersection(*(set(f.hypothesis.terms) for f in fits)) if fits else set()


def evidence(a: Scored, b: Scored) -> float:
    """Logarithm of the likelihood ratio of `a` to `b`, by all windows."""
    return _ratio(a, b, b.by_joint - a.by_joint)


def held_out_evidence(a: Scored, b: Scored) -> float:
    """The same by windows that neither was fitted to."""
    return _ratio(a, b, (b.by_joint - a.by_joint)[a.train.size :])


def _ratio(a: Scored, b: Scored, gain: Array) -> float:
    """Logarithm of the likelihood ratio of `a` to `b` from paired gains [W, joints], with how likely either is
    beforehand. Where the better one leaves nothing but noise of the size that it was taken to have, half of their sum
    counts, though few windows make it."""
    ratio, least = log_ratio(gain), 0.5 * float(gain.sum())
    better = a if least > 0.0 else b
    told = least if abs(least) > abs(ratio) and better.noise_alone else ratio
    return told + b.unlikely - a.unlikely


def clearly_worse(a: Scored, best: Scored) -> bool:
    """Whether `a` loses to the best beyond doubt."""
    return beyond_doubt(evidence(best, a))
