"""Regression of forces on many candidate effects at once: normal equations by block of time and actuator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

Array = np.ndarray
ROUNDS = 20
"""Most changes of which bounds hold."""
RIDGE = 1e-9


@dataclass(frozen=True)
class Normal:
    """Normal equations of P columns, by part of the recordings (K of them) and, for sums, by block of time (B).

    Attributes:
        gram: [K, nu, P, P]. moment: [K, nu, P]. square: [K, nu] of what is to be explained.
        rows: [B, nu] how many. column_sum: [B, nu, P]. target_sum: [B, nu] sums over the rows.
        prior: [P] precision of each coefficient's weak prior. low, high: [P] bounds.
    """

    gram: Array
    moment: Array
    square: Array
    rows: Array
    column_sum: Array
    target_sum: Array
    prior: Array
    low: Array
    high: Array

    @staticmethod
    def of(
        columns: Array, target: Array, block: Array, fold: Array, prior: Array, low: Array, high: Array
    ) -> Normal:
        """columns: [P, N, nu]. target: [N, nu] (NaN: unknown). block: [N] its number. fold: [B] part of each block."""
        seen = np.isfinite(target)
        y = np.where(seen, target, 0.0)
        gram, moment, square = [], [], []
        for k in np.unique(fold):
            r = np.isin(block, np.flatnonzero(fold == k))
            # [nu, P, n] @ [nu, n, P]
            x = np.ascontiguousarray(np.where(seen[r], columns[:, r], 0.0).transpose(2, 0, 1))
            gram.append(x @ x.transpose(0, 2, 1))
            moment.append((x @ y[r].T[..., None])[..., 0])
            square.append((y[r] ** 2).sum(0))
        each = [block == b for b in range(int(block.max()) + 1)]
        rows = np.array([seen[r].sum(0) for r in each])
        column_sum = np.array([np.where(seen[r], columns[:, r], 0.0).sum(1).T for r in each])
        target_sum = np.array([y[r].sum(0) for r in each])
        return Normal(
            np.array(gram), np.array(moment), np.array(square), rows, column_sum, target_sum, prior, low, high
        )

    @cached_property
    def pooled(self) -> tuple[Array, Array, Array]:
        """gram [nu, P, P], moment and square of all parts."""
        return self.gram.sum(0), self.moment.sum(0), self.square.sum(0)

    def weighted(self, weight: Array) -> Weighted:
        """The same with actuators weighted by `weight` [nu]: one over the variance of their rows."""
        parts, count, _, size = self.gram.shape
        # as one row for each actuator nothing is copied
        grams = (weight @ self.gram.reshape(parts, count, -1)).reshape(parts, size, size)
        return Weighted(self, weight, grams, weight @ self.moment)


@dataclass(frozen=True)
class Weighted:
    """Normal equations whose actuators are weighted. weight: [nu]. grams: [K, P, P]. moments: [K, P]."""

    normal: Normal
    weight: Array
    grams: Array
    moments: Array

    @cached_property
    def without(self) -> tuple[Array, Array]:
        """grams and moments of all parts but one."""
        return self.grams.sum(0) - self.grams, self.moments.sum(0) - self.moments

    def solve(self, chosen: Sequence[int], pull: Array | float = 0.0) -> Array:
        """Coefficients of the chosen columns on all parts, within their bounds. pull: of the prior, where it is not
        centred on 0."""
        gram, moment = self.all
        return self._solve(np.array(chosen, dtype=int), gram, moment, pull)

    def alike(self, chosen: Sequence[int]) -> Array:
        """How many neighbouring rows have one error in common [nu], in the fit to all parts: the mean square of the
        blocks' sums over that of as many independent errors."""
        index, n = np.array(chosen, dtype=int), self.normal
        x = self.solve(chosen)
        sums = n.target_sum - n.column_sum[..., index] @ x
        common = (sums**2).sum(0) / np.maximum(_errors(x, index, *n.pooled), 1e-300)
        longest = n.rows.sum(0) / len(n.rows)
        return np.clip(common, 1.0, np.maximum(longest, 1.0))

    def sureness(self, chosen: Sequence[int], alike: Array) -> Array:
        """Each coefficient of the fit to all parts over its standard deviation, if `alike` [nu] neighbouring rows have
        one error in common."""
        _, covariance = self.spread(chosen, alike)
        return np.abs(self.solve(chosen)) / np.sqrt(np.maximum(np.diag(covariance), 1e-300))

    def spread(self, chosen: Sequence[int], alike: Array) -> tuple[Array, Array]:
        """Information of the rows [p, p] on the chosen coefficients, and their covariance, if `alike` [nu] neighbouring
        rows have one error in common."""
        index = np.array(chosen, dtype=int)
        gram, prior = self.normal.pooled[0][:, index[:, None], index], np.diag(self.normal.prior[index])
        information, shared = (np.einsum("u,upq->pq", w, gram) for w in (self.weight, self.weight * alike))
        inverse = np.linalg.pinv(information + prior, hermitian=True)
        return information, inverse @ (shared + prior) @ inverse

    def left(self, chosen: Sequence[int]) -> Array:
        """Squared errors [nu] of the fit to all parts."""
        index = np.array(chosen, dtype=int)
        return _errors(self.solve(chosen), index, *self.normal.pooled)

    @cached_property
    def all(self) -> tuple[Array, Array]:
        """Weighted gram [P, P] and moment of all parts."""
        return self.grams.sum(0), self.moments.sum(0)

    def _solve(self, index: Array, gram: Array, moment: Array, pull: Array | float = 0.0) -> Array:
        n = self.normal
        reduced = gram[np.ix_(index, index)] + np.diag(n.prior[index])
        return bounded(reduced, moment[index] + pull, n.low[index], n.high[index])

    def predicted(self, chosen: Sequence[int]) -> Array:
        """Squared errors [nu] of all parts, each with coefficients from the others."""
        index, n = np.array(chosen, dtype=int), self.normal
        grams, moments = self.without
        parts = zip(grams, moments, n.gram, n.moment, n.square, strict=True)
        return np.sum([_errors(self._solve(index, g, m), index, *of) for g, m, *of in parts], axis=0)


def _errors(x: Array, index: Array, gram: Array, moment: Array, square: Array) -> Array:
    """|y - A x|^2 [...] from normal equations [..., P, P]."""
    if not index.size:
        return square
    picked = gram[..., index[:, None], index]
    return np.maximum(square - 2 * moment[..., index] @ x + (picked @ x) @ x, 0.0)


def bounded(gram: Array, moment: Array, low: Array, high: Array) -> Array:
    """argmin of x'Gx / 2 - m'x within bounds, by fixing what leaves them and freeing what is pulled back."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram, moment = gram * scale[:, None] * scale + RIDGE * np.eye(len(gram)), moment * scale
    low, high = low / scale, high / scale
    x, fixed = np.zeros(len(gram)), np.zeros(len(gram), bool)
    for _ in range(ROUNDS):
        free = ~fixed
        if free.any():
            rest = moment[free] - gram[np.ix_(free, fixed)] @ x[fixed]
            x[free] = np.linalg.solve(gram[np.ix_(free, free)], rest)
        outside = free & ((x < low) | (x > high))
        x = np.clip(x, low, high)
        pull = moment - gram @ x
        released = fixed & (((x <= low) & (pull > 1e-12)) | ((x >= high) & (pull < -1e-12)))
        if not outside.any() and not released.any():
            break
        fixed = (fixed | outside) & ~released
    return x * scale
