"""What a rule of the diagnosis is, and what stands in its place when it is switched off.

A rule is a function of the engine whose answer it changes. Without it that function answers otherwise: something fixed,
or the same with another number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mpge_jax.diagnosis.evidence.held_out_error import fit_report
from mpge_jax.diagnosis.evidence.paired_gains import deviations, standard_error

Own = Callable[..., Any]
INF = float("inf")


@dataclass(frozen=True)
class Gate:
    """A rule that can be switched off.

    Attributes:
        name: of the rule. meaning: what it is for. numbers: those that go with it. where: `module:function`, below
            `mpge_jax.diagnosis`, whose answers it changes. off: what is answered instead, given the function and its
            arguments. acted: whether it changed anything, by the function's answer and arguments, where `off` takes as
            long as the function itself; None: by comparison with what `off` answers.
    """

    name: str
    meaning: str
    numbers: tuple[str, ...]
    where: str
    off: Own
    acted: Callable[..., bool] | None = None


def fixed(value: Any) -> Own:
    """The same answer always."""
    return lambda _own, *_args, **_options: value


def numbers(**values: float) -> Own:
    """The same function with other values of its module's numbers."""

    def off(own: Own, *args: Any, **options: Any) -> Any:
        home = own.__globals__
        kept = {name: home[name] for name in values}
        home.update(values)
        try:
            return own(*args, **options)
        finally:
            home.update(kept)

    return off


def given(number: int) -> Own:
    """The argument with that number, unchanged."""
    return lambda _own, *args, **_options: args[number]


def changed(number: int) -> Callable[..., bool]:
    """Whether the answer is another hypothesis than the argument with that number."""
    return lambda answer, *args, **_options: answer.hypothesis != args[number].hypothesis


def something(answer: Any, *_args: Any, **_options: Any) -> bool:
    return answer is not None and answer is not False


def by_mean_alone(_own: Own | None, gain: np.ndarray) -> float:
    return float(gain.mean()) / max(standard_error(gain), 1e-300)


def all_kept(_own: Own, fits: list[Any], _before: float) -> list[Any]:
    return sorted(fits, key=lambda f: f.loss)


def confirmed_without(part: str) -> Own:
    def off(own: Own, p: Any, s: Any, f: Any, asked: Any) -> Any:
        if asked != part:
            return own(p, s, f, asked)
        return f, fit_report(p, f, asked), []

    return off


def went(part: str) -> Callable[..., bool]:
    return lambda answer, _p, _s, _f, asked: asked == part and bool(answer[2])


def one_truth(own: Own, p: Any, f: Any, shaken: Any = None, limit: int = 16) -> Any:
    """The floor of the model's own steps alone."""
    home = own.__globals__
    return home["_floor"](p, f, home["force_noise"](p) if shaken is None else shaken, limit, finer=False)


def in_all(own: Own, floor: Any, left: Any) -> bool:
    """By all degrees of freedom together alone."""
    return bool(floor.exceeded(left.losses[left.typical]) or floor.far(left.losses))


def directions_alone(own: Own, s: Any, ranked: list[Any], *rest: Any) -> Any:
    """The choice among ties by the number of parameters, however direct an explanation is."""
    scored = type(ranked[0])
    kept = scored.complexity
    scored.complexity = property(lambda r: (r.directions, r.fit.theta.size))
    try:
        return own(s, ranked, *rest)
    finally:
        scored.complexity = kept


def first_of_ties(own: Own, s: Any, ranked: list[Any], *rest: Any) -> Any:
    """The best of those that are named, however near the next simpler one comes."""
    named = own.__globals__["named"]
    return next((r for r in ranked if named(s, r.fit, *rest)), ranked[0])


def doubt_none(own: Own, new: Any, old: Any, *_doubt: Any, **_options: Any) -> bool:
    return own(new, old, -INF)


def one_ratio(_own: Own, new: Any, old: Any, doubt: float = 3.0) -> bool:
    """Whether held-out windows gain by a likelihood ratio of 20 to 1, for each of a hundred candidates where one of
    them was chosen (`doubt` of 3), less where gains scatter more than such a ratio's do."""
    held = old.held - new.held
    ratio = 0.5 * float((old.by_joint - new.by_joint)[old.train.size :].sum())
    # a gain of twice the ratio has a variance of four times as much where windows scatter by noise alone
    by_scatter = 2.0 * max(deviations(held), 0.0) ** 2
    return min(ratio, by_scatter) > math.log(20.0) + (math.log(100.0) if doubt >= 3.0 else 0.0)
