"""Whether a form of an effect that idealises less is closer to what acts: dry friction that gives way before it slides,
a payload that has an extent, a spring that hardens, a limit with a soft knee. What the plain form leaves would be taken
for something else (a flexible drive, masses that are off), and the parameters would bear it."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.closer import Closer
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit, slopes_of
from mpge_jax.diagnosis.selection.competition import at_noise
from mpge_jax.diagnosis.selection.criteria import needed
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.thresholds import NAMED

ITERATIONS = 12


def closer(s: Search, current: Fitted) -> Fitted:
    """`current` with the closer forms of its effects, all at once, less those that turn out no better than the plain
    ones, where held-out windows are predicted better so beyond doubt."""
    ctx = s.sim.ctx
    plain = [t for t in current.hypothesis.terms if t.effect.closer and _closer(_form(t)).fits(ctx, t.place)]
    if not plain or s.sim.rugged(current.hypothesis):
        return current
    white = s.whiten_one(current, s.train)
    if at_noise(s, current, white):
        return current
    sample = s.sample(current, white)
    slopes, starts = slopes_of(s.sim, current, *sample), _with_closer(ctx, current, plain)
    quick = fit(s.sim, starts, *sample, iterations=ITERATIONS, slopes=slopes, anew=False)
    best = min(quick, key=lambda f: f.loss)
    if best.loss >= evaluate(s.sim, [current], *sample)[0].loss:
        return current
    best = fit(s.sim, [best], s.train, white, iterations=ITERATIONS)[0]
    idle = [t for t in best.hypothesis.terms if t.id != t.plain and not _differs(ctx, best, t)]
    if idle:
        best = fit(s.sim, [with_plain(ctx, best, idle)], s.train, white, iterations=ITERATIONS)[0]
    found = len(set(best.hypothesis.terms) - set(current.hypothesis.terms))
    if not found:
        return current
    whites = s.whiten(best)
    best, old = fit(s.sim, [best, current], s.train, whites[0], iterations=ITERATIONS)
    new, before = s.score([best, old], whites)
    better = needed(new, before, 1, found)
    s.log.append(
        f"closer forms: {before.losses.mean():.3f} -> {new.losses.mean():.3f}"
        + ("" if better else " (not accepted)")
    )
    return best if better else current


def _with_closer(ctx: Context, f: Fitted, terms: list[Term]) -> list[Fitted]:
    """`f` with the closer forms of some effects, from small differences to large ones."""
    parts, starts = f.hypothesis.split(ctx, f.theta), {}
    for t in terms:
        form = _form(t)
        starts[t] = form, _closer(form).starts_from(ctx, t.place, parts[t])
    return [
        _exchanged(ctx, f, {t: (form, each[min(k, len(each) - 1)]) for t, (form, each) in starts.items()})
        for k in range(max(len(each) for _, each in starts.values()))
    ]


def with_plain(ctx: Context, f: Fitted, terms: list[Term]) -> Fitted:
    """`f` with the plain forms of some of its closer ones."""
    parts = f.hypothesis.split(ctx, f.theta)
    plain = {t: (Term(t.plain, t.place), parts[t][: -_closer(t).further]) for t in terms}
    return _exchanged(ctx, f, plain)


def _exchanged(ctx: Context, f: Fitted, others: dict[Term, tuple[Term, np.ndarray]]) -> Fitted:
    parts = {t: x for t, x in f.hypothesis.split(ctx, f.theta).items() if t not in others}
    h = Hypothesis.of(*parts, *(form for form, _ in others.values()))
    theta = h.gather(ctx, parts | dict(others.values()))
    return Fitted(h, theta, theta.copy())


def _differs(ctx: Context, f: Fitted, term: Term) -> bool:
    """Whether a closer form's first own parameter differs from none."""
    i = f.hypothesis.slices(ctx)[f.hypothesis.terms.index(term)].stop - _closer(term).further
    return bool(abs(f.theta[i]) > NAMED * np.sqrt(max(f.cov[i, i], 0.0)))


def _form(plain: Term) -> Term:
    """The closer form of a term."""
    return Term(plain.id + plain.effect.closer, plain.place)


def _closer(term: Term) -> Closer:
    """The effect of a term that is a closer form."""
    effect = term.effect
    assert isinstance(effect, Closer)
    return effect
