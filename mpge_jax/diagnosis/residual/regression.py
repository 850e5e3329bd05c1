"""Which smooth function explains what is left: penalised least squares, judged on blocks that it was not fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.effects.residual.axis import INPUTS
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt, by_scatter

Array = np.ndarray
STRENGTHS = 10.0 ** np.arange(-6.0, 2.5)
"""Weights of the penalty that are tried, in units of the mean information of a value."""
SMALL = 0.01
"""Weight of the values themselves beside that of their second differences."""
TIE = 0.01
"""Share of what the best function explains by which a plainer one may explain less."""
HALF = 0.5
"""Share of it from which on a function may still turn out to be the best one."""


@dataclass(frozen=True)
class Blocks:
    """A least-squares problem of a function's values, block by block: ||r + A x||^2 = whole + 2 push x + x gram x.

    Attributes:
        gram: [B, P, P]. push: [B, P]. whole: [B]. weight: [B] of the blocks.
    """

    gram: Array
    push: Array
    whole: Array
    weight: Array

    @staticmethod
    def of(columns: Array, residual: Array, weight: Array) -> Blocks:
        """From columns [P, B, M] and residuals [B, M]."""
        return Blocks(
            np.einsum("pbm,qbm->bpq", columns, columns, optimize=True),
            np.einsum("pbm,bm->bp", columns, residual, optimize=True),
            (residual**2).sum(-1),
            weight,
        )

    def take(self, index: Array) -> Blocks:
        return Blocks(self.gram[index], self.push[index], self.whole[index], self.weight[index])

    def summed(self) -> tuple[Array, Array]:
        """Weighted sums of `gram` [P, P] and `push` [P]."""
        return np.tensordot(self.weight, self.gram, 1), self.weight @ self.push

    def told_at(self, now: Array) -> Blocks:
        """A problem of changes of the values `now` [P] as one of the values."""
        push = self.push - self.gram @ now
        whole = self.whole - 2.0 * self.push @ now + np.einsum("p,bpq,q->b", now, self.gram, now)
        return Blocks(self.gram, push, whole, self.weight)

    def left(self, x: Array) -> Array:
        """Weighted squares [S, B] with values x [S, P]."""
        square = np.einsum("sp,bpq,sq->sb", x, self.gram, x, optimize=True)
        return self.weight * (self.whole + 2.0 * x @ self.push.T + square)


@dataclass(frozen=True)
class Rows:
    """The same with one number a block: (residual + x columns)^2.

    Attributes:
        columns: [P, B]. residual: [B]. weight: [B].
    """

    columns: Array
    residual: Array
    weight: Array

    @property
    def whole(self) -> Array:
        return self.residual**2

    def take(self, index: Array) -> Rows:
        return Rows(self.columns[:, index], self.residual[index], self.weight[index])

    def summed(self) -> tuple[Array, Array]:
        weighted = self.columns * self.weight
        return weighted @ self.columns.T, weighted @ self.residual

    def left(self, x: Array) -> Array:
        """Weighted squares [S, B] with values x [S, P]."""
        return np.asarray(self.weight * (self.residual + x @ self.columns) ** 2)


Candidate = tuple[Residual, int, Blocks]
"""A function, the index of the joint at which it acts, and the least-squares problem of its values."""


@dataclass(frozen=True)
class Choice:
    """A function with its values.

    Attributes:
        place: index of the joint at which it acts. left: [B] what it leaves of every block, told from the others.
        strength: of its penalty.
    """

    effect: Residual
    place: int
    values: Array
    left: Array
    strength: float


def roughness(effect: Residual) -> Array:
    """[P, P] of squared second differences along every input, and a little of the values themselves."""
    each = [np.eye(count) for count in effect.counts]
    second = [_second(one, axis.around) for one, axis in zip(each, effect.axes, strict=True)]
    along = [x.T @ x for x in second]
    if len(each) == 1:
        (rough,) = along
    else:
        rough = np.kron(along[0], each[1]) + np.kron(each[0], along[1])
    return rough + SMALL * np.eye(len(rough))


def _second(x: Array, around: bool) -> Array:
    """Second differences of rows; `around`, the first follows the last."""
    return np.roll(x, -1, 0) - 2.0 * x + np.roll(x, 1, 0) if around else np.diff(x, 2, axis=0)


def solved(gram: Array, push: Array, rough: Array, strengths: Array) -> Array:
    """The values [S, P] that are best for `Blocks.summed` under penalties of S strengths.

    Args:
        rough: `roughness`.
    """
    mean = max(float(np.trace(gram)) / len(gram), 1e-300)
    penalised = gram + (strengths * mean)[:, None, None] * rough
    return -np.linalg.solve(penalised, push[:, None])[..., 0]


@dataclass(frozen=True)
class Told:
    """A function that predicts blocks, from the others, better than nothing beyond chance.

    Attributes:
        number: of the candidate. gain: what of the weighted squares goes with it.
    """

    number: int
    choice: Choice
    gain: float


def told(candidates: list[Candidate], fold: Array) -> list[Told]:
    """The functions that predict blocks, from the others, better than nothing beyond chance.

    Args:
        candidates: function, index of the joint at which it acts, its problem. fold: [B] which blocks are predicted
            together.
    """
    if len(np.unique(fold)) < 2:
        return []
    out = []
    for k, (effect, place, b) in enumerate(candidates):
        choice = smoothed(effect, place, b, fold)
        less = b.weight * b.whole - choice.left
        if beyond_doubt(by_scatter(less), len(candidates)):
            out.append(Told(k, choice, float(less.sum())))
    return out


def best_function(tried: list[Told]) -> Choice | None:
    """The plainest of the functions that predict as well as the best one does; None where there is none.

    Plain is what has few inputs, is a force, has the joint's own inputs, and known ones rather than computed ones (the
    order of `INPUTS`), and repeats often within a turn.
    """
    if not tried:
        return None
    best = max(tried, key=lambda t: t.gain)
    near = [
        t.choice
        for t in tried
        if t.gain > (1.0 - TIE) * best.gain or not beyond_doubt(by_scatter(t.choice.left - best.choice.left))
    ]
    return min(near, key=lambda c: _elaborate(c.effect))


def in_the_race(tried: list[Told]) -> list[int]:
    """Numbers of the candidates that may still turn out to be the best one where the rest is known better."""
    most = max(t.gain for t in tried)
    return [t.number for t in tried if t.gain > HALF * most]


def fewest(tried: list[Choice]) -> Choice:
    """Of functions of ever more values, the first that is not beyond doubt worse than the best one."""
    best = min(tried, key=lambda c: float(c.left.sum()))
    return next(c for c in tried if not beyond_doubt(by_scatter(c.left - best.left)))


def _elaborate(effect: Residual) -> tuple[int, bool, list[tuple[bool, int, int]]]:
    return (
        len(effect.axes),
        effect.dry,
        [(bool(a.joint), list(INPUTS).index(a.input), -a.parts) for a in effect.axes],
    )


def smoothed(effect: Residual, place: int, b: Blocks | Rows, fold: Array) -> Choice:
    """The function under the penalty that predicts best."""
    rough, (gram, push) = roughness(effect), b.summed()
    left = np.empty((STRENGTHS.size, len(fold)))
    for k in np.unique(fold):
        here = b.take(fold == k)
        its_gram, its_push = here.summed()
        left[:, fold == k] = here.left(solved(gram - its_gram, push - its_push, rough, STRENGTHS))
    best = int(np.argmin(left.sum(1)))
    (values,) = solved(gram, push, rough, STRENGTHS[best : best + 1])
    return Choice(effect, place, values, left[best], float(STRENGTHS[best]))
