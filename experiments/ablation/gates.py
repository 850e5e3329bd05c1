"""What a rule of the diagnosis is, and what stands in its place when it is switched off.

A rule is a function of the engine whose answer it changes. Without it that function answers otherwise: something fixed,
or the same with another number.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mpge_jax.diagnosis.evidence.held_out_error import fit_report
from mpge_jax.diagnosis.evidence.likelihood_ratio import by_scatter, log_ratio, standard_error

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


def within(low: float, high: float, off: Own) -> Callable[..., bool]:
    """Whether a number that nothing asks for more exactly below `low` and above `high` is another one with `off`."""

    def acted(answer: float, *args: Any, **options: Any) -> bool:
        return bool(np.clip(answer, low, high) != np.clip(off(None, *args, **options), low, high))

    return acted


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


def half_the_sum(_own: Own | None, gain: np.ndarray) -> float:
    """The logarithm of a likelihood ratio as if a window were one observation."""
    return 0.5 * float(gain.sum())


def whoever_is_better(_own: Own | None, _a: Any, _b: Any, gain: np.ndarray) -> float:
    """The logarithm of a likelihood ratio, whatever the better hypothesis leaves."""
    return log_ratio(gain)


def scatter_alone(_own: Own | None, gain: np.ndarray) -> float:
    """The logarithm of a likelihood ratio by how windows scatter, however slight their gains are."""
    return by_scatter(gain if gain.ndim == 1 else gain.sum(1))
