"""Sentences for people."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.intervals import parameters
from mpge_jax.diagnosis.estimation.quantities import clause, intervals, quantity
from mpge_jax.diagnosis.report.error_words import (
    beyond_noise,
    error_unit,
    gain,
    makes_up,
    moves,
    percent,
    untold,
    worse_without,
)
from mpge_jax.diagnosis.residual.model import Function, ResidualModel
from mpge_jax.diagnosis.verdict.result import Result, ties_of

SEVERAL = 3
"""Places from which on one effect is told for all of them in a sentence."""


def _said(d: Result, f: Fitted, term: Term) -> str:
    """What an effect's sentence says; it may begin with the name of a place."""
    less = _less(d, f, term)
    entries = list(parameters(d.ctx, f, term).items())
    values = {k: quantity(_turned(v) if less and not i else v) for i, (k, v) in enumerate(entries)}
    return term.effect.sentence(term.place, values, less)


def _less(d: Result, f: Fitted, term: Term) -> bool:
    """Whether the model has too much of an effect, and not too little."""
    return bool(term.effect.says_less) and bool(f.hypothesis.split(d.ctx, f.theta)[term][0] < 0.0)


def _turned(entry: dict[str, Any]) -> dict[str, Any]:
    """A parameter entry with the other sign."""
    return entry | {"value": -entry["value"], "low": -entry["high"], "high": -entry["low"]}


def _listed(names: list[str]) -> str:
    """'a, b and c'."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _alike(terms: list[Term], d: Result) -> dict[Term, list[Term]]:
    """Effects of one parameter that act at several places, each with all of its kind and sense."""
    kinds: dict[tuple[str, bool], list[Term]] = {}
    for t in terms:
        if len(t.params(d.ctx)) == 1:
            kinds.setdefault((t.id, _less(d, d.fit, t)), []).append(t)
    return {t: kind for kind in kinds.values() if len(kind) >= SEVERAL for t in kind}


def _said_together(d: Result, terms: list[Term]) -> str:
    """'Viscous damping that the model lacks: 16 N m s/rad at shoulder and 2.1 N m s/rad at elbow.'"""
    less = _less(d, d.fit, terms[0])
    entries = [(v, t.place.name) for t in terms for v in parameters(d.ctx, d.fit, t).values()]
    values = [f"{quantity(_turned(v) if less else v)} at {at}" for v, at in entries]
    what = terms[0].name.replace("_", " ")
    how = "of which the model has too much" if less else "that the model lacks"
    return f"{what[0].upper() + what[1:]} {how}: {_listed(values)}."


def _of_effects(d: Result) -> Iterator[tuple[float, str]]:
    """A sentence for every effect, or for several that are alike, with the largest share of the error that goes with
    one of them."""
    ties = ties_of(d)
    ambiguous = {t for terms, _ in ties for t in terms}
    for terms, fits in ties:
        options = [_option(d, f, _differing(d, f, terms)) for f in fits]
        yield _share(d, list(terms)), f"The recordings cannot tell which: {', or '.join(options)}."
    alike = _alike([t for t in d.terms if t not in ambiguous], d)
    for term in (t for t in d.terms if t not in ambiguous):
        if term not in alike:
            text = _said(d, d.fit, term)
            yield _share(d, [term]), text[0].upper() + text[1:]
        elif term is alike[term][0]:
            yield _share(d, alike[term]), _said_together(d, alike[term])


def _option(d: Result, f: Fitted, terms: list[Term]) -> str:
    """'the encoder of the wrist reports 0.030 s late', a clause for each of different effects; or 'actuator gain of
    1.2 at left and 1.2 at right together'."""
    if len({t.name for t in terms}) == len(terms):
        return _listed([clause(_said(d, f, t)) for t in terms])
    each = [
        f"{_listed([quantity(v) for v in parameters(d.ctx, f, t).values()])} at {t.place.name}" for t in terms
    ]
    return f"{terms[0].name.replace('_', ' ')} of {_listed(each)} together"


def _of_inertias(d: Result) -> list[str]:
    """What is said of the given masses and inertias where they are off, with the one that is off most."""
    changes = [
        (abs(body[what]["value"] - 1.0), f"{_off(body[what]['value'])} {what} at {body['at']}")
        for what in ("mass", "inertia")
        for body in d.given_inertias or []
    ]
    if not changes:
        return []
    return [
        "The given masses and inertias are not exact, which is usual and no missing physics; corrected.xml has better "
        f"ones (what changes most: {max(changes)[1]})."
    ]


def _off(factor: float) -> str:
    """'1.2 % less'"""
    return f"{100 * abs(factor - 1.0):.2g} % {'more' if factor > 1.0 else 'less'}"


def _share(d: Result, terms: list[Term]) -> float:
    """The largest share of the error that goes with one of some effects; 0 where none is known."""
    return max(np.nan_to_num(d.error_drop[t]) for t in terms)


def explanation(d: Result) -> str:
    """What a technician needs to know, in a few sentences; what takes most of the error away comes first."""

    parts = [text for _, text in sorted(_of_effects(d), key=lambda x: -x[0])]
    parts += _of_inertias(d)
    if d.actuators is not None:
        parts += d.actuators.sentences
    if d.unexplained is not None:
        where = _listed(d.unexplained["at"]) or "machine"
        known = "Beyond that, something" if parts else "Something"
        said = f"{known} acts at the {where} that no known effect explains: {d.unexplained['when']}."
        # of an error of which nothing is explained, all of it says nothing
        if parts:
            said += " " + makes_up(d.unexplained)
        parts.append(said + _doubt(d))
    if d.residual is not None:
        parts.append(_residual(d.residual, error_unit(d)))
    if not parts:
        parts.append(
            "Nothing is missing: the model predicts the recordings as well as their noise and its timestep allow."
        )
    if d.fit.hypothesis.terms or (d.actuators is not None and d.actuators.fits):
        parts.append(gain(d))
        if d.unexplained is None and not d.remainder and (more := untold(d)):
            parts.append(more)
    if d.remainder > 0:
        parts.append(
            f"A remainder of {percent(d.remainder)} of the squared error is more than noise"
            f"{beyond_noise(d)}; it is too slight to change what is named."
        )
    return " ".join(parts)


def _doubt(d: Result) -> str:
    """What is said of effects that may be a part of what has no name."""
    if not d.doubtful:
        return ""
    names = [f"{t.name.replace('_', ' ')} at {t.place.name}" for t in d.doubtful]
    return (
        f" What was named there may be a part of the same: too much is left beside {_listed(names)} to be sure of "
        f"{'it' if len(names) == 1 else 'them'}."
    )


def _residual(r: ResidualModel, unit: str) -> str:
    """What is left as functions, and what they do to recordings that they never saw."""
    each = [
        f"{f.effect.what} at the {f.term.place.name}, as a smooth function {of_inputs(f)}"
        for f in r.functions
    ]
    return (
        f"It is modelled all the same: {'; '.join(each)}: with it the error of held-out "
        f"recordings {moves(r.before, r.after, unit)}."
    )


def of_inputs(f: Function) -> str:
    """'of the position q of the joint (about 0.31 sin(2q) N m, for -1.2 < q < 1.2 rad)'; the letters only where
    there is a formula of them."""
    said = [f"the {a.says}" for a in f.axes]
    if f.formula is None:
        return f"of {_listed(said)}"
    lettered = [x.replace(" of", f" {a.letter} of", 1) for x, a in zip(said, f.axes, strict=True)]
    return f"of {_listed(lettered)} ({f.formula})"


def effect_rows(table: dict[str, Any]) -> list[list[str]]:
    """A row for every parameter of every effect in `diagnosis.json`: effect, place, parameter, value, 95 % interval,
    and how much larger the held-out error is without the effect; the effect without which it is largest comes first."""
    rows = []
    for e in sorted(table["effects"], key=lambda e: -(e.get("error_drop") or 0.0)):
        without = "" if e.get("error_drop") is None else worse_without(e["error_drop"])
        for name, p in (e["parameters"] or {"": None}).items():
            rows.append([e["id"], e["at"], name, *((quantity(p), intervals(p)) if p else ("", "")), without])
    return rows


def _differing(d: Result, f: Fitted, terms: tuple[Term, ...]) -> list[Term]:
    """What a fit has of some terms, or else what it has in their place."""
    here = [t for t in terms if t in f.hypothesis.terms]
    return here or [t for t in f.hypothesis.named if t not in d.terms]


def alone(places: list[str]) -> str:
    """The experiment that shows what has no name by itself."""
    return (
        f"move {' and '.join(places)} alone, slowly and fast, both ways and under several loads, so that all that acts "
        "there can be drawn against angle, speed and load"
    )


def separation(d: Result, terms: tuple[Term, ...], fits: list[Fitted]) -> str:
    """The experiment that would tell the candidates apart."""
    others = [t for f in fits for t in _differing(d, f, terms)]
    places = list(dict.fromkeys(t.place.name for t in others))
    movable = all(t.place.kind in ("joint", "actuator", "body") for t in others)
    if movable and len(places) > 1 and len({t.name for t in others}) == 1:
        return f"move {' and '.join(places)} one at a time"
    remedies = [t.effect.remedy for t in others]
    unique = list(dict.fromkeys(r for r in remedies if r))
    # one that says more says the other too
    unique = [r for r in unique if not any(r != more and r in more for more in unique)]
    return "; ".join(unique)[:600] or "move every joint over its whole range at several speeds"
