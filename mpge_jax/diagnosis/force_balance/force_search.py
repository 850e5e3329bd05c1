"""Which effects the forces need: groups over all joints and single ones, by how well they predict other stretches."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt
from mpge_jax.diagnosis.force_balance.bank import Bank, Entry, hypothesis_of
from mpge_jax.diagnosis.force_balance.force_moves import Chosen, additions, exchanges, groups
from mpge_jax.diagnosis.force_balance.gram import Weighted
from mpge_jax.diagnosis.thresholds import ELSEWHERE

Array = np.ndarray
LEAST = 0.2
"""Share of the squared error that must go with an effect at the actuator where it takes away most."""
CLEAR = 2.0
"""Standard deviations from which on what other joints have too is seen at this one."""
DISTINCT = 1e-3
"""Share of a direction's squared force that no other gives, from which on it is one of its own."""
SHOWN = 12
"""Candidates that are judged by stretches that they were not fitted to: those that fit best."""


@dataclass(frozen=True)
class Judged:
    """A hypothesis with what it leaves.

    Attributes:
        errors: [nu] squared errors of the forces, every part of the recordings predicted from the others.
        alike: [nu] how many neighbouring rows have one error in common.
    """

    chosen: Chosen
    errors: Array
    alike: Array

    @property
    def complexity(self) -> float:
        return sum(len(e.columns) + 0.75 * e.term.effect.tier for e in self.chosen)


@dataclass(frozen=True)
class Found:
    """The end of a search: what was chosen, and what stood against each part of it, best first."""

    best: Judged
    rivals: dict[Term, list[Judged]]


@dataclass
class ForceSearch:
    """Forward selection, each step followed by dropping what is not needed, and exchanges in the end.

    One statistic decides: the logarithm of the likelihood ratio of two hypotheses on stretches that they were not
    fitted to, each actuator with its own variance, and with as many independent errors as its neighbouring rows leave.
    What is added or kept must win beyond doubt, given how many candidates there are.

    Attributes:
        log: lines of it are added. most: effects at most. excluded: candidates that are not tried.
    """

    bank: Bank
    say: Callable[[str], None]
    log: list[str]
    most: int
    excluded: frozenset[Entry] = frozenset()

    def __post_init__(self) -> None:
        normal = self.bank.normal
        self.rows = normal.rows.sum(0)
        self.entries = [e for e in self.bank.entries if e not in self.excluded]
        self.among = len({e.term for e in self.entries})
        self.least = 1e-8 * normal.square.sum(0) + 1e-300
        self.groups = groups(self.entries)

    def run(self, chosen: Chosen = ()) -> Found:
        """The chosen hypothesis, with rivals of each of its terms; the search goes on from what is `chosen`."""
        best = self._exchanged(self._grown(self._pruned(self.judged(chosen, self.weights(chosen)))))
        weighted = self.weights(best.chosen)
        return Found(best, {e.term: self._rivals(best, e, weighted) for e in best.chosen})

    def _grown(self, best: Judged) -> Judged:
        while len(best.chosen) < self.most:
            weighted = self.weights(best.chosen)
            found = self._best_of(additions(self.entries, self.groups, best.chosen), best, weighted)
            if found is None:
                break
            pruned = self._pruned(found)
            if self.ratio(pruned, best) <= 0.0:
                break
            best = pruned
            self.log.append(f"forces: {hypothesis_of(best.chosen)}")
            self.say(f"{len(best.chosen)} effects so far")
        return self._completed(best)

    def _completed(self, best: Judged) -> Judged:
        """With what other joints have too where it is clearly seen, though alone it would not win."""
        while True:
            weighted = self.weights(best.chosen)
            found: list[tuple[float, Judged]] = []
            for e in self.entries:
                if (
                    e.term.effect.tier > 1
                    or len(e.columns) > 1
                    or not compatible(hypothesis_of(best.chosen), e.term)
                ):
                    continue
                if sum(o.term.id == e.term.id for o in best.chosen) >= ELSEWHERE:
                    more = self.judged((*best.chosen, e), weighted)
                    sure = weighted.sureness(self.bank.columns(more.chosen), more.alike)[-1]
                    if sure > CLEAR and (ratio := self.ratio(more, best)) > 0.0:
                        found.append((ratio, more))
            if not found or len(best.chosen) >= self.most:
                return best
            best = max(found, key=lambda x: x[0])[1]

    def _exchanged(self, best: Judged) -> Judged:
        """With another effect in the place of one, or of two with several parameters, where that predicts better beyond
        doubt, or better and is plainer: step by step, two may have come to stand for one."""
        while True:
            better = [
                j
                for j in self._fitting(exchanges(self.entries, best.chosen), self.weights(best.chosen))
                if self._wins(j, best) or (j.complexity < best.complexity and self.ratio(j, best) > 0.0)
            ]
            if not better:
                return best
            best = self._pruned(min(better, key=lambda j: self._score(j.errors)))
            self.log.append(f"forces: {hypothesis_of(best.chosen)}")

    def parts(self, chosen: Chosen) -> dict[Term, Array]:
        """Parameters by term, as if all were linear."""
        return self.bank.parts(chosen, self.weights(chosen).solve(self.bank.columns(chosen)))

    def ratio(self, a: Judged, b: Judged) -> float:
        """Logarithm of the likelihood ratio of `a` to `b`."""
        count = self.rows / np.maximum(a.alike, b.alike)
        return float((0.5 * count * np.log((b.errors + self.least) / (a.errors + self.least))).sum())

    def _wins(self, a: Judged, b: Judged) -> bool:
        share = 1.0 - a.errors / np.maximum(b.errors, 1e-300)
        return beyond_doubt(self.ratio(a, b), self.among) and float(share.max(initial=0.0)) > LEAST

    def directions(self, e: Entry) -> int:
        """How many different forces an effect can give along these motions."""
        index = np.array(e.columns, dtype=int)
        gram = self.bank.normal.pooled[0][:, index[:, None], index].sum(0)
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        return int((np.linalg.eigvalsh(gram / scale[:, None] / scale) > DISTINCT).sum())

    def _needs(self, best: Judged, without: Judged, e: Entry, sure: float) -> bool:
        """Whether `best` needs one of its effects. What other joints have too is likely here: it need not be shown
        beyond doubt, but predict better than nothing in its place."""
        shared = e.term.effect.tier == 1 and any(
            o.term.id == e.term.id and o is not e and o.term.place.kind == e.term.place.kind
            for o in best.chosen
        )
        if shared:
            return sure > CLEAR
        return self._wins(best, without)

    def _score(self, errors: Array) -> float:
        """Mean logarithm of the actuators' squared errors."""
        seen = self.rows > 0
        return float(np.log(errors[seen] + self.least[seen]).mean())

    def weights(self, chosen: Chosen) -> Weighted:
        """Actuators weighted by one over what is left of their errors."""
        normal = self.bank.normal
        left = normal.square.sum(0)
        for _ in range(3):
            variance = np.maximum(left, self.least) / np.maximum(self.rows, 1)
            weighted = normal.weighted(np.where(self.rows > 0, 1.0 / variance, 0.0))
            if not chosen:
                break
            left = weighted.left(self.bank.columns(chosen))
        return weighted

    def judged(self, chosen: Chosen, weighted: Weighted) -> Judged:
        columns = self.bank.columns(chosen)
        return Judged(chosen, weighted.predicted(columns), weighted.alike(columns))

    def _best_of(self, moves: Iterable[Chosen], now: Judged, weighted: Weighted) -> Judged | None:
        """The plainest of the moves that predict as well as the best one, if that is better than `now`."""
        judged = [j for j in self._fitting(moves, weighted) if self._wins(j, now)]
        judged.sort(key=lambda j: self._score(j.errors))
        alike = [j for j in judged if not beyond_doubt(self.ratio(judged[0], j))]
        return min(alike, key=lambda j: j.complexity, default=None)

    def _fitting(self, moves: Iterable[Chosen], weighted: Weighted) -> list[Judged]:
        """The `SHOWN` of the moves that fit best."""
        return [self.judged(m, weighted) for m in self._ranked(moves, weighted)[:SHOWN]]

    def _ranked(self, moves: Iterable[Chosen], weighted: Weighted) -> list[Chosen]:
        """The moves, those that fit best first."""
        return sorted(moves, key=lambda m: self._score(weighted.left(self.bank.columns(m))))

    def _pruned(self, best: Judged) -> Judged:
        """Drop, one by one, what predicts no better than nothing in its place."""
        while best.chosen:
            weighted = self.weights(best.chosen)
            best = self.judged(best.chosen, weighted)
            columns = self.bank.columns(best.chosen)
            sure = weighted.sureness(columns, best.alike)
            at = np.cumsum([0, *(len(e.columns) for e in best.chosen)])
            less = [
                (e, sure[a:b].max(), self.judged(tuple(o for o in best.chosen if o is not e), weighted))
                for e, a, b in zip(best.chosen, at[:-1], at[1:], strict=True)
            ]
            needless = [j for e, sure, j in less if not self._needs(best, j, e, sure)]
            if not needless:
                break
            best = max(needless, key=lambda j: self.ratio(j, best))
        return best

    def _rivals(self, best: Judged, own: Entry, weighted: Weighted) -> list[Judged]:
        """What could stand in the place of one effect, best first."""
        rest = tuple(e for e in best.chosen if e is not own)
        hypothesis = hypothesis_of(rest)
        moves = [
            (*rest, e)
            for e in self.entries
            if e.term != own.term and e.term.effect.named and compatible(hypothesis, e.term)
        ]
        out: dict[Term, Judged] = {}
        for m in self._ranked(moves, weighted):
            if m[-1].term not in out and len(out) < 5:
                out[m[-1].term] = self.judged(m, weighted)
        return list(out.values())
