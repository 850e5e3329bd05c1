"""The rules that decide what a diagnosis says of a driven machine, and what stands in the place of each without it.

A rule is a function of the engine whose answer it changes. Without it that function answers otherwise: something fixed,
or the same with another number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

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
    where: tuple[str, ...]
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


def _given(number: int) -> Own:
    """The argument with that number, unchanged."""
    return lambda _own, *args, **_options: args[number]


def _changed(number: int) -> Callable[..., bool]:
    """Whether the answer is another hypothesis than the argument with that number."""
    return lambda answer, *args, **_options: answer.hypothesis != args[number].hypothesis


def _something(answer: Any, *_args: Any, **_options: Any) -> bool:
    return answer is not None and answer is not False


def _by_mean_alone(_own: Own | None, gain: np.ndarray) -> float:
    n = gain.size
    error = float(gain.std(ddof=1) / np.sqrt(n)) if n > 1 else INF
    return float(gain.mean()) / max(error, 1e-300)


def _all_kept(_own: Own, fits: list[Any], _before: float) -> list[Any]:
    return sorted(fits, key=lambda f: f.loss)


def _confirmed_without(part: str) -> Own:
    def off(own: Own, p: Any, s: Any, f: Any, asked: Any) -> Any:
        if asked != part:
            return own(p, s, f, asked)
        from mpge_jax.diagnosis.evidence.held_out_error import fit_report

        return f, fit_report(p, f, asked), []

    return off


def _went(part: str) -> Callable[..., bool]:
    return lambda answer, _p, _s, _f, asked: asked == part and bool(answer[2])


def _one_truth(own: Own, p: Any, f: Any, *args: Any, **options: Any) -> Any:
    """The floor of the model's own steps alone."""
    from types import SimpleNamespace

    contacts = p.ctx.contacts
    if not contacts:
        return own(p, f, *args, **options)
    module = own.__globals__
    kept = module["_floor"]
    own_steps: list[Any] = []

    def once(prepared: Any, f: Any, shaken: Any, limit: int, finer: bool) -> Any:
        if finer:
            return SimpleNamespace(loss=-INF)
        own_steps.append(kept(prepared, f, shaken, limit, finer))
        return own_steps[-1]

    module["_floor"] = once
    try:
        return own(p, f, *args, **options)
    finally:
        module["_floor"] = kept


def _in_all(own: Own, floor: Any, left: Any) -> bool:
    """By all degrees of freedom together alone."""
    return bool(floor.exceeded(left.losses[left.typical]) or floor.far(left.losses))


def _directions_alone(own: Own, s: Any, ranked: list[Any], *rest: Any) -> Any:
    """The choice among ties by the number of parameters, however direct an explanation is."""
    scored = type(ranked[0])
    kept = scored.complexity
    scored.complexity = property(lambda r: (r.directions, r.fit.theta.size))
    try:
        return own(s, ranked, *rest)
    finally:
        scored.complexity = kept


def _first_of_ties(own: Own, s: Any, ranked: list[Any], *rest: Any) -> Any:
    """The best of those that are named, however near the next simpler one comes."""
    named = own.__globals__["named"]
    return next((r for r in ranked if named(s, r.fit, *rest)), ranked[0])


def _doubt_none(own: Own, new: Any, old: Any, *_doubt: Any, **_options: Any) -> bool:
    return own(new, old, -INF)


def _one_ratio(own: Own, new: Any, old: Any, doubt: float = 3.0) -> bool:
    """Whether held-out windows gain by a likelihood ratio of 20 to 1, for each of a hundred candidates where one of
    them was chosen (`doubt` of 3), less where gains scatter more than such a ratio's do."""
    home = own.__globals__
    held = old.held - new.held
    ratio = 0.5 * float((old.by_joint - new.by_joint)[old.train.size :].sum())
    # a gain of twice the ratio has a variance of four times as much where windows scatter by noise alone
    by_scatter = 2.0 * max(home["deviations"](held), 0.0) ** 2
    return min(ratio, by_scatter) > math.log(20.0) + (math.log(100.0) if doubt >= 3.0 else 0.0)


CRITERIA, COMPETITION = "selection.criteria", "selection.competition"
FORWARD, ALTERNATIVES = "selection.forward_selection", "selection.alternatives"
NULL, PAIRED, SCORED = "evidence.null_distribution", "evidence.paired_gains", "evidence.scored"
NEEDED = (f"{CRITERIA}:needed",)
ASKED = (1.0, 1.8, 3.0)
"""Standard errors that anything of the engine asks for."""

GATES = (
    Gate(
        "significant",
        "windows gain by more standard errors than chance",
        ("SIGNIFICANT", "BESIDE"),
        NEEDED,
        _doubt_none,
    ),
    Gate(
        "beside",
        "held-out windows need fewer standard errors beside known effects",
        ("BESIDE",),
        NEEDED,
        numbers(BESIDE=1.0),
    ),
    Gate(
        "evidence",
        "held-out windows gain by a likelihood ratio",
        ("EVIDENCE",),
        NEEDED,
        numbers(EVIDENCE=-INF),
    ),
    Gate(
        "all of these and the next two",
        "in their place: one likelihood ratio of held-out windows, by the number of candidates",
        (),
        NEEDED,
        _one_ratio,
    ),
    Gate(
        "strong",
        "large gains in few windows count though their mean is uncertain",
        ("STRONG", "BALANCE"),
        (f"{PAIRED}:strong",),
        fixed(False),
    ),
    Gate(
        "rare",
        "what acts in several windows that stand out counts though the mean hardly moves",
        ("SEVERAL", "ORDINARY", "OUTLYING", "CLEARLY"),
        (f"{PAIRED}:rare",),
        fixed(False),
    ),
    Gate(
        "by ranks",
        "gains count by their ranks too",
        (),
        (f"{PAIRED}:deviations",),
        _by_mean_alone,
        lambda answer, gain: any((answer > x) != (_by_mean_alone(None, gain) > x) for x in ASKED),
    ),
    Gate(
        "named",
        "parameters differ from where the effect vanishes",
        ("NAMED",),
        (f"{CRITERIA}:named",),
        fixed(True),
    ),
    Gate(
        "moves",
        "a further effect moves predictions by a share of the error",
        ("SMALL",),
        (f"{CRITERIA}:moves",),
        fixed(True),
    ),
    Gate(
        "tie",
        "slight differences of loss are ties",
        ("TIE",),
        (f"{SCORED}:clearly_worse",),
        numbers(TIE=0.0),
    ),
    Gate(
        "simplest of ties",
        "of candidates that tie the simplest is chosen",
        (),
        (f"{CRITERIA}:choose",),
        _first_of_ties,
    ),
    Gate(
        "tier",
        "of candidates that tie the more direct explanation is chosen",
        ("tier",),
        (f"{CRITERIA}:choose",),
        _directions_alone,
    ),
    Gate(
        "hopeful",
        "candidates that gain less than half of the best are fitted no further",
        ("FEW",),
        (f"{SCORED}:hopeful",),
        _all_kept,
    ),
    Gate(
        "hopeless",
        "no second effect is looked for where screening promises little",
        ("HOPELESS",),
        (f"{COMPETITION}:hopeless",),
        lambda _own, _s, screened, _before: not screened,
    ),
    Gate(
        "loud",
        "one joint's loss alone keeps a search going",
        ("LOUD",),
        (f"{COMPETITION}:only_noise",),
        numbers(LOUD=INF),
    ),
    Gate(
        "quiet",
        "a mean loss a little above that of noise is noise",
        ("QUIET",),
        (f"{COMPETITION}:only_noise",),
        numbers(QUIET=1.0),
    ),
    Gate(
        "standing out",
        "several windows that stand out keep a search going",
        ("SEVERAL",),
        (f"{COMPETITION}:only_noise",),
        numbers(SEVERAL=10**9),
    ),
    Gate(
        "at the floor",
        "a search ends at what a true hypothesis would leave, by simulation",
        ("SETTLED",),
        (f"{COMPETITION}:at_floor",),
        fixed(False),
        _something,
    ),
    Gate(
        "pairs",
        "second effects are tried beside several first ones",
        ("LEAVES_MUCH",),
        (f"{FORWARD}:_second_round",),
        lambda _own, _s, chosen, _beam: (chosen.fit, [chosen]),
        lambda answer, _s, chosen, _beam: answer[0] is not chosen.fit,
    ),
    Gate(
        "every joint",
        "friction, damping and rotor inertia are tried in every joint at once",
        ("AFTER", "HALF"),
        ("selection.all_joints:everywhere",),
        _given(1),
        _changed(1),
    ),
    Gate(
        "pruned",
        "effects that later ones make needless go",
        ("WEAKEST",),
        ("selection.backward_elimination:prune",),
        _given(1),
        _changed(1),
    ),
    Gate(
        "exchanged",
        "an effect gives way to an alternative that predicts better",
        ("EXCHANGES",),
        (f"{ALTERNATIVES}:better_rival",),
        fixed(None),
    ),
    Gate(
        "seen from itself",
        "the nearest alternative is compared under its own noise too",
        (),
        (f"{ALTERNATIVES}:_seen_from_itself",),
        _given(3),
        lambda answer, _s, _best, _term, rivals: answer is not rivals,
    ),
    Gate(
        "richer",
        "laws that contain a plain friction are fitted from where it stands",
        ("RICHER", "SETTLED"),
        (f"{ALTERNATIVES}:_richer",),
        fixed([]),
        lambda answer, *_: bool(answer),
    ),
    Gate(
        "contained",
        "a law that contains the chosen one is no tie",
        (),
        (f"{ALTERNATIVES}:_contains",),
        fixed(False),
    ),
    Gate(
        "common",
        "an added mass may tie with a direction more",
        ("COMMON",),
        (f"{ALTERNATIVES}:_compare",),
        numbers(COMMON=0),
    ),
    Gate(
        "same in principle",
        "effects that no motion tells apart tie always",
        (),
        ("evidence.same_in_principle:same",),
        fixed(False),
    ),
    Gate(
        "longer windows",
        "where nothing was found or something is left, longer windows are looked at",
        ("WORTH_ANOTHER_LOOK",),
        ("selection.procedure:_on_longer_windows",),
        lambda _own, _p, _s, f, _say: (f, {}),
        lambda answer, _p, _s, f, _say: answer[0] is not f,
    ),
    Gate(
        "chosen by others",
        "effects that recordings for choosing do not gain by go",
        ("BEYOND",),
        ("selection.confirmation:confirmed",),
        _confirmed_without("choice"),
        _went("choice"),
    ),
    Gate(
        "tested",
        "effects that test recordings do not gain by go",
        ("BEYOND",),
        ("selection.confirmation:confirmed",),
        _confirmed_without("test"),
        _went("test"),
    ),
    Gate(
        "structure",
        "an excess below that is none",
        ("EXCESS",),
        (f"{NULL}:Floor.exceeded",),
        numbers(EXCESS=0.0),
    ),
    Gate(
        "doubt",
        "an excess within so many standard errors is none",
        ("DOUBT",),
        (f"{NULL}:Floor.exceeded",),
        lambda own, floor, losses, *_doubt: own(floor, losses, 0.0),
    ),
    Gate(
        "far windows",
        "several windows far beyond the floor are more than noise",
        ("BEYOND_NOISE",),
        (f"{NULL}:Floor.far",),
        fixed(False),
    ),
    Gate(
        "joint by joint",
        "one degree of freedom may show more than the floor by itself",
        ("WINDOWS_BY_JOINT",),
        (f"{NULL}:Floor.beyond",),
        _in_all,
    ),
    Gate(
        "finer steps",
        "with contacts the floor is that of finer steps where it is higher",
        (),
        (f"{NULL}:floor",),
        _one_truth,
        lambda _answer, p, *_args, **_options: bool(p.ctx.contacts),
    ),
    Gate(
        "other starts",
        "what strikes may start elsewhere within its uncertainty",
        ("ORDINARY", "MOST"),
        ("estimation.initial_states:settled",),
        _given(2),
        lambda answer, _sim, _f, w, *_args, **_options: answer is not w,
    ),
    Gate(
        "too far from nothing",
        "a large error is not nothing, whatever the search found",
        ("FAR",),
        ("verdict.judgement:too_far",),
        fixed(False),
    ),
    Gate(
        "slight",
        "a slight share of the squared error that is left is told beside the effects",
        ("SLIGHT", "CLEAR"),
        ("verdict.judgement:matters",),
        fixed(True),
    ),
)


def gate(name: str) -> Gate:
    """The gate of that name; ValueError where there is none."""
    for each in GATES:
        if each.name == name:
            return each
    raise ValueError(f"there is no rule {name!r} (there are: {', '.join(g.name for g in GATES)})")


WORK = {
    "selection.all_joints": ("ITERATIONS",),
    "selection.competition": ("KEEP", "KEEP_OF_MANY"),
    "selection.confirmation": ("ITERATIONS",),
    "selection.forward_selection": ("REST",),
    "selection.procedure": ("REFINED",),
    "selection.search_state": ("MANY", "WORK"),
    "selection.setup": ("POOL", "FEWEST_ROWS"),
    "evidence.null_distribution": ("SEGMENT", "ALL"),
    "evidence.same_in_principle": ("PARALLEL",),
}
"""Numbers of the rooms that decide which are no rule: how much is tried or shown (candidates, windows, iterations)."""
