"""Whether the dry friction that was found gives way elastically before it slides: then what is left would be taken for
a flexible drive, and what else is named would bear it."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.base import ELASTIC
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.friction.dry import Dry
from mpge_jax.diagnosis.effects.friction.elastic import OWN, Elastic, elastic_of
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit
from mpge_jax.diagnosis.selection.competition import at_noise
from mpge_jax.diagnosis.selection.criteria import needed
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.thresholds import NAMED

ITERATIONS = 6


def giving_way(s: Search, current: Fitted) -> Fitted:
    """`current` with elastic forms of the laws of dry friction that it holds, all at once, less those that turn out
    rigid, where held-out windows are predicted better so beyond doubt."""
    ctx = s.sim.ctx
    rigid = [t for t in current.hypothesis.terms if isinstance(t.effect, Dry)]
    if not rigid or s.sim.rugged(current.hypothesis):
        return current
    white = s.whiten_one(current, s.train)
    if at_noise(s, current, white):
        return current
    sample = s.sample(current, white)
    quick = fit(s.sim, _with_elastic(ctx, current, rigid), *sample, iterations=ITERATIONS)
    best = min(quick, key=lambda f: f.loss)
    if best.loss >= evaluate(s.sim, [current], *sample)[0].loss:
        return current
    best = fit(s.sim, [best], s.train, white, iterations=ITERATIONS)[0]
    stiff = [t for t in best.hypothesis.terms if isinstance(t.effect, Elastic) and not _bends(ctx, best, t)]
    if stiff:
        best = fit(s.sim, [with_rigid(ctx, best, stiff)], s.train, white, iterations=ITERATIONS)[0]
    found = len(set(best.hypothesis.terms) - set(current.hypothesis.terms))
    if not found:
        return current
    whites = s.whiten(best)
    old = fit(s.sim, [current], s.train, whites[0], iterations=ITERATIONS)[0]
    new, before = s.score([best, old], whites)
    better = needed(new, before, 1, found)
    s.log.append(
        f"elastic friction: {before.losses.mean():.3f} -> {new.losses.mean():.3f}"
        + ("" if better else " (not accepted)")
    )
    return best if better else current


def _with_elastic(ctx: Context, f: Fitted, terms: list[Term]) -> list[Fitted]:
    """`f` with the elastic forms of some laws, by how far they give way to begin with."""
    forms = {t: Term(t.id + ELASTIC, t.place) for t in terms}
    parts = f.hypothesis.split(ctx, f.theta)
    starts = {t: elastic_of(form.id).bent(ctx, t.place, parts[t]) for t, form in forms.items()}
    return [
        _exchanged(ctx, f, {t: (form, starts[t][k]) for t, form in forms.items()})
        for k in range(len(next(iter(starts.values()))))
    ]


def with_rigid(ctx: Context, f: Fitted, terms: list[Term]) -> Fitted:
    """`f` with some elastic laws as they are where they do not give way."""
    parts = f.hypothesis.split(ctx, f.theta)
    return _exchanged(ctx, f, {t: (Term(t.law, t.place), parts[t][:-OWN]) for t in terms})


def _exchanged(ctx: Context, f: Fitted, others: dict[Term, tuple[Term, np.ndarray]]) -> Fitted:
    parts = {t: x for t, x in f.hypothesis.split(ctx, f.theta).items() if t not in others}
    h = Hypothesis.of(*parts, *(form for form, _ in others.values()))
    theta = h.gather(ctx, parts | dict(others.values()))
    return Fitted(h, theta, theta.copy())


def _bends(ctx: Context, f: Fitted, term: Term) -> bool:
    """Whether the compliance of an elastic law differs from none."""
    i = f.hypothesis.slices(ctx)[f.hypothesis.terms.index(term)].stop - OWN
    return bool(f.theta[i] > NAMED * np.sqrt(max(f.cov[i, i], 0.0)))
