"""Whether a form of an effect that idealises less is closer to what acts: dry friction that gives way before it slides,
a payload that has an extent, a spring that hardens, a limit with a soft knee. What the plain form leaves would be taken
for something else (a flexible drive, masses that are off), and the parameters would bear it."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.candidates import closer_forms, compatible
from mpge_jax.diagnosis.effects.closer import Closer
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.friction.dry import CREEPING
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit, slopes_of
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt
from mpge_jax.diagnosis.evidence.scored import evidence
from mpge_jax.diagnosis.selection.competition import at_noise
from mpge_jax.diagnosis.selection.criteria import moves, needed, strength
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.thresholds import NAMED

ITERATIONS, IN_COMMON = 12, 4
COMMON = (
    {"coulomb_friction": CREEPING},
    {i.partition(":")[0]: i for i in REGISTRY if i.endswith((":limited", ":servo"))},
)
"""Other forms of effects that a machine has alike everywhere: how dry friction sets in, and on which side of their
drives' limits they act."""


def closer(s: Search, current: Fitted) -> Fitted:
    """`current` with closer forms of its effects where held-out windows are predicted better so beyond doubt: the first
    forms of all effects together, then the second ones, be it in place of the first. A form that stands without what it
    shows beside is tried once more with it."""
    if not at_noise(s, current, s.whiten_one(current, s.train)):
        current = in_common_forms(s, current)
    for turn in range(max((len(REGISTRY[t.plain].closer) for t in current.hypothesis.terms), default=0)):
        current = _with_better(s, current, _forms(s, current, turn))
    return _one_for_two(s, current)


def in_common_forms(s: Search, f: Fitted) -> Fitted:
    """`f` with the forms that its effects have alike in the whole machine (`COMMON`), where windows are predicted
    better with them beyond doubt: they make no other effects, but move the sizes of what acts beside them."""
    for forms in COMMON:
        f = _in_other_forms(s, f, forms)
    return f


def _in_other_forms(s: Search, f: Fitted, forms: dict[str, str]) -> Fitted:
    """`f`, or with all effects in their other form, back from it where none is in the plain one."""
    ctx, parts = s.sim.ctx, f.hypothesis.split(s.sim.ctx, f.theta)
    others = {}
    for either in (forms, {other: plain for plain, other in forms.items()}):
        others = {t: Term(either[t.id], t.place) for t in parts if t.id in either}
        others = {t: x for t, x in others.items() if t.place in x.effect.places(ctx)}
        if others:
            break
    if not others:
        return f
    start = f.exchanged(ctx, others, {x: parts[t] for t, x in others.items()})
    whites = s.whiten(f)
    # what else moves, and what these do, is all but the same in both
    slopes = dict(slopes_of(s.sim, f, s.train, whites[0]))
    slopes |= {x: slopes[t] for t, x in others.items()}
    fits = fit(s.sim, [start, f], s.train, whites[0], iterations=IN_COMMON, slopes=slopes, anew=False)
    changed, as_is = s.score(fits, whites)
    return changed.fit if beyond_doubt(evidence(changed, as_is)) else f


def _forms(s: Search, current: Fitted, turn: int) -> dict[Term, Term]:
    """The closer forms that are tried of the terms of a fit at a turn; of what the model has too much there is none."""
    out, parts = {}, current.hypothesis.split(s.sim.ctx, current.theta)
    for t in current.hypothesis.terms:
        if t.effect.says_less and parts[t][0] < 0.0:
            continue
        for ending in REGISTRY[t.plain].closer[turn : turn + 1]:
            form = Term(t.plain + ending, t.place)
            if t != form or _beside(s, current, form):
                out[t] = form
    return {t: form for t, form in out.items() if _closer(form).fits(s.sim.ctx, t.place)}


def _beside(s: Search, f: Fitted, form: Term) -> list[Term]:
    """What a form shows beside, where that may be added."""
    return _addable(s, f, _closer(form).beside, form)


def _addable(s: Search, f: Fitted, effect: str, form: Term) -> list[Term]:
    """An effect at the place of a form, where that may be added."""
    other = Term(effect, form.place)
    return [other] if other in s.terms and compatible(f.hypothesis, other) else []


def _with_better(s: Search, current: Fitted, forms: dict[Term, Term]) -> Fitted:
    """`current` with closer `forms` of some effects: with those that clearly differ from the plain ones, or with all,
    if it is better so."""
    if not forms:
        return current
    white = s.whiten_one(current, s.train)
    if at_noise(s, current, white):
        return current
    sample = s.sample(current, white)
    slopes = {t: x for t, x in slopes_of(s.sim, current, *sample).items() if t not in forms}
    starts = _with_closer(s, current, forms)
    quick = fit(s.sim, starts, *sample, iterations=ITERATIONS, slopes=slopes, anew=False)
    best = min(quick, key=lambda f: f.loss)
    if best.loss >= evaluate(s.sim, [current], *sample)[0].loss or not moves(s, best, current):
        return current
    changed, as_is = s.score([best, current], (white, s.whiten_one(current, s.held, white.factor)))
    if beyond_doubt(evidence(as_is, changed)):
        # what a sample alone speaks for
        return current
    every = fit(s.sim, [best], s.train, white, iterations=ITERATIONS)[0]
    fewer = _without_idle(s, current, every)
    some = [] if fewer.hypothesis in (current.hypothesis, every.hypothesis) else [fewer]
    whites = s.whiten(every)
    imitated = _imitated(s, current, forms)
    *scored, old = s.score(
        fit(s.sim, [*imitated, *some, every, current], s.train, whites[0], iterations=ITERATIONS), whites
    )
    like, tried = scored[: len(imitated)], scored[len(imitated) :]
    chosen = old
    for new in tried:
        if all(needed(new, x, 1, len(_further(x.fit, new.fit))) for x in (chosen, *like)):
            chosen = new
    s.log.append(
        "closer forms: "
        + "; ".join(f"{x.fit.hypothesis} {x.losses.mean():.3f}" for x in (old, *tried))
        + ("" if chosen is not old else " (not accepted)")
    )
    return current if chosen is old else chosen.fit


def _one_for_two(s: Search, current: Fitted) -> Fitted:
    """`current` with the closer form of one effect in the place of two, where held-out windows are predicted as well by
    that: what does not follow the plain form, the two together imitate."""
    terms = current.hypothesis.terms
    starts = [
        fewer
        for t in terms
        for other in terms
        if other != t and other.place == t.place and other.effect.named
        for fewer in _without(s, current, other, t)
    ]
    if not starts:
        return current
    whites = s.whiten(current)
    quick = fit(s.sim, starts, *s.sample(current, whites[0]), iterations=ITERATIONS, anew=False)
    best = min(quick, key=lambda f: f.loss)
    one, two = s.score(fit(s.sim, [best, current], s.train, whites[0], iterations=ITERATIONS), whites)
    if needed(two, one):
        return current
    s.log.append(f"one for two: {current.hypothesis} -> {one.fit.hypothesis}")
    return one.fit


def _without(s: Search, current: Fitted, other: Term, t: Term) -> list[Fitted]:
    """`current` without an effect and with each closer form of another, where that leaves fewer parameters."""
    ctx = s.sim.ctx
    rest = current.of_terms(ctx, current.hypothesis.without(other))
    if t.id != t.plain:
        return [rest]
    starts = [start for form in closer_forms(ctx, t) for start in _with_closer(s, rest, {t: form})]
    return [start for start in starts if start.theta.size < current.theta.size]


def _without_idle(s: Search, current: Fitted, every: Fitted) -> Fitted:
    """`every` with the plain forms of those closer ones that hardly differ from them, and without what was added beside
    these or is itself hardly there."""
    ctx, further, strong = s.sim.ctx, _further(current, every), strength(s, every)
    closer_ones = {t for t in further if t.id != t.plain}
    idle = [t for t in closer_ones if not _differs(ctx, every, t)]
    places = {t.place for t in closer_ones.difference(idle)}
    gone = {t for t in further - closer_ones if t.place not in places or strong[t] < NAMED}
    fewer = with_plain(ctx, every, idle)
    return fewer.of_terms(ctx, Hypothesis.of(*(t for t in fewer.hypothesis.terms if t not in gone)))


def _further(old: Fitted, new: Fitted) -> set[Term]:
    """Terms that only the new fit has."""
    return set(new.hypothesis.terms) - set(old.hypothesis.terms)


def _imitated(s: Search, f: Fitted, forms: dict[Term, Term]) -> list[Fitted]:
    """`f` with what imitates closer forms beside the plain ones, to be fitted; nothing where nothing does."""
    others = [x for form in forms.values() for x in _addable(s, f, _closer(form).imitated_by, form)]
    return [f.beside_nothing(s.sim.ctx, *others)] if others else []


def _with_closer(s: Search, f: Fitted, forms: dict[Term, Term]) -> list[Fitted]:
    """`f` with closer forms of some effects, and with what they show beside, from small differences to large ones."""
    ctx = s.sim.ctx
    parts, starts = f.hypothesis.split(ctx, f.theta), {}
    for t, x in forms.items():
        starts[t] = x, _closer(x).starts_from(ctx, t.place, _of_plain(ctx, t, parts[t]))
        starts |= {other: (other, other.effect.null(ctx, other.place)[None]) for other in _beside(s, f, x)}
    return [
        f.exchanged(ctx, starts, {form: each[min(k, len(each) - 1)] for form, each in starts.values()})
        for k in range(max(len(each) for _, each in starts.values()))
    ]


def with_plain(ctx: Context, f: Fitted, terms: list[Term]) -> Fitted:
    """`f` with the plain forms of some of its closer ones."""
    parts = f.hypothesis.split(ctx, f.theta)
    plain = {Term(t.plain, t.place): _of_plain(ctx, t, parts[t]) for t in terms}
    return f.exchanged(ctx, terms, plain)


def _of_plain(ctx: Context, term: Term, theta: np.ndarray) -> np.ndarray:
    """The parameters of the plain form in those of a term."""
    return theta[: len(REGISTRY[term.plain].params(ctx, term.place))]


def _differs(ctx: Context, f: Fitted, term: Term) -> bool:
    """Whether a closer form's first own parameter differs from none."""
    i = f.hypothesis.slices(ctx)[f.hypothesis.terms.index(term)].stop - _closer(term).further
    return bool(abs(f.theta[i]) > NAMED * np.sqrt(max(f.cov[i, i], 0.0)))


def _closer(term: Term) -> Closer:
    """The effect of a term that is a closer form."""
    effect = term.effect
    assert isinstance(effect, Closer)
    return effect
