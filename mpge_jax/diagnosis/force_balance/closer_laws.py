"""Laws of friction that idealise less in the place of plain ones, where other stretches of the recordings say so."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mpge_jax.diagnosis.effects.candidates import closer_forms, plain_form
from mpge_jax.diagnosis.effects.closer import Closer
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt
from mpge_jax.diagnosis.force_balance.bank import Bank, Entry, hypothesis_of
from mpge_jax.diagnosis.force_balance.force_search import ForceSearch, Judged
from mpge_jax.diagnosis.force_balance.gram import Weighted
from mpge_jax.diagnosis.force_balance.needed_force import can_ask

Array = np.ndarray


def closer_laws(search: ForceSearch, parts: dict[Term, Array]) -> tuple[Bank, dict[Term, Array]] | None:
    """Fitted parameters with closer forms of those laws of friction by which stretches that nothing was fitted to are
    predicted better beyond doubt, near where these belong, and the regression there; None where no form is better.

    Nothing is named by it: that much of the error goes with it, as a search asks of a further effect, is not asked.
    """
    ctx = search.bank.balance.ctx
    plain = {form: t for t in parts for form in closer_forms(ctx, t) if t.id == t.plain and _asked(ctx, form)}
    starts = [(form, x) for form, t in plain.items() for x in _starts(ctx, form, parts[t])]
    if not starts:
        return None
    near = replace(search, bank=search.bank.near([*parts.items(), *starts]))
    entries = near.bank.entries[-len(parts) - len(starts) :]
    given, forms = tuple(entries[: len(parts)]), entries[len(parts) :]
    own = {e.term: e for e in given}
    exchange = _Exchange(near, {e: own[plain[e.term]] for e in forms})
    first = best = near.judged(given, near.weights(given))
    while (better := exchange.better(best)) is not None:
        best = better
        search.log.append(f"forces: {hypothesis_of(best.chosen)}")
    return None if best is first else (near.bank, near.parts(best.chosen))


@dataclass(frozen=True)
class _Exchange:
    """Closer forms in the place of plain effects.

    Attributes:
        plain: what each form, at each of its starts, stands for.
    """

    search: ForceSearch
    plain: dict[Entry, Entry]

    def better(self, now: Judged) -> Judged | None:
        """The best that beats what is there: one form, or all of a kind, as robots are made alike in every joint."""
        weighted = self.search.weights(now.chosen)
        alone = {e: self._with(now, [e], weighted) for e, own in self.plain.items() if own in now.chosen}
        # of each form that of its starts which predicts best
        forms = {e.term: e for e in sorted(alone, key=lambda e: self.search.ratio(alone[e], now))}
        kinds = [[e for t, e in forms.items() if t.id == i] for i in dict.fromkeys(t.id for t in forms)]
        tried = [(alone[e], len(forms)) for e in forms.values()]
        tried += [
            (self._needed(self._with(now, kind, weighted), kind, weighted), len(kinds)) for kind in kinds
        ]
        better = [j for j, among in tried if beyond_doubt(self.search.ratio(j, now), among)]
        return max(better, key=lambda j: self.search.ratio(j, now), default=None)

    def _with(self, now: Judged, forms: list[Entry], weighted: Weighted) -> Judged:
        gone = [self.plain[e] for e in forms]
        return self.search.judged((*(e for e in now.chosen if e not in gone), *forms), weighted)

    def _needed(self, all_of_them: Judged, forms: list[Entry], weighted: Weighted) -> Judged:
        """Without those forms, one by one, without which other stretches are predicted as well."""
        best = all_of_them
        for e in forms:
            rest = (*(o for o in best.chosen if o is not e), self.plain[e])
            fewer = self.search.judged(rest, weighted)
            if self.search.ratio(fewer, best) >= 0.0:
                best = fewer
        return best


def _asked(ctx: Context, form: Term) -> bool:
    """Whether forces tell a form, and may be predicted as well by the plain friction in it."""
    return can_ask(form) and bool(plain_form(ctx, form, form.effect.starts(ctx, form.place)[0]))


def _starts(ctx: Context, form: Term, theta: Array) -> Array:
    """Starts [k, p] of a closer form from the plain effect's parameters."""
    assert isinstance(form.effect, Closer)
    return form.effect.starts_from(ctx, form.place, theta)
