"""The rules that decide what a diagnosis says of a driven machine, with their numbers."""

from __future__ import annotations

import math

from experiments.ablation.gates import (
    INF,
    Gate,
    all_kept,
    by_mean_alone,
    changed,
    confirmed_without,
    directions_alone,
    first_of_ties,
    fixed,
    given,
    half_the_sum,
    numbers,
    one_truth,
    scatter_alone,
    something,
    went,
    whoever_is_better,
    within,
)
from mpge_jax.diagnosis.evidence.scored import evidence
from mpge_jax.diagnosis.thresholds import SURE, USUALLY

CRITERIA, COMPETITION = "selection.criteria", "selection.competition"
ALTERNATIVES = "selection.alternatives"
NULL, RATIO, SCORED = "evidence.null_distribution", "evidence.likelihood_ratio", "evidence.scored"
ASKED = (SURE, SURE + 2.0 * math.log(500.0))
"""Between which values anything asks for the logarithm of a likelihood ratio: pairs of up to 500 effects."""
NEEDED, LOG_RATIO = f"{CRITERIA}:needed", f"{RATIO}:log_ratio"

GATES = (
    Gate(
        "sure",
        "an effect is needed if held-out windows gain by a likelihood ratio",
        ("SURE",),
        NEEDED,
        fixed(True),
    ),
    Gate(
        "chosen of many",
        "that ratio is larger the more candidates there were",
        (),
        NEEDED,
        lambda own, new, old, *_choices: own(new, old),
    ),
    Gate(
        "by scatter",
        "a likelihood ratio is told by how windows scatter",
        (),
        LOG_RATIO,
        half_the_sum,
        within(*ASKED, half_the_sum),
    ),
    Gate(
        "by size",
        "gains that are slight in all say nothing, however regular they are",
        (),
        LOG_RATIO,
        scatter_alone,
        within(*ASKED, scatter_alone),
    ),
    Gate(
        "by ranks",
        "gains count by their ranks too",
        (),
        f"{RATIO}:deviations",
        by_mean_alone,
        within(1.0, ASKED[1], by_mean_alone),
    ),
    Gate(
        "face value",
        "where the better hypothesis leaves noise alone, gains of few windows count for what they are",
        (),
        f"{SCORED}:_ratio",
        whoever_is_better,
        within(*ASKED, whoever_is_better),
    ),
    Gate(
        "named",
        "parameters differ from where the effect vanishes",
        ("NAMED",),
        f"{CRITERIA}:named",
        fixed(True),
    ),
    Gate(
        "moves",
        "a further effect moves predictions by a share of the error",
        ("MOVES",),
        f"{CRITERIA}:moves",
        fixed(True),
    ),
    Gate(
        "tie",
        "what the ratio does not tell apart is a tie",
        ("SURE",),
        f"{SCORED}:clearly_worse",
        lambda _own, a, best: evidence(best, a) > 0.0,
    ),
    Gate(
        "simplest of ties",
        "of candidates that tie the simplest is chosen",
        (),
        f"{CRITERIA}:choose",
        first_of_ties,
    ),
    Gate(
        "tier",
        "of candidates that tie the more direct explanation is chosen",
        ("INDIRECT",),
        f"{CRITERIA}:choose",
        directions_alone,
    ),
    Gate(
        "hopeful",
        "candidates that gain less than half of the best are fitted no further",
        ("HALF_AS_GOOD", "FAMILIES"),
        f"{SCORED}:hopeful",
        all_kept,
    ),
    Gate(
        "hopeless",
        "no second effect is looked for where screening promises little",
        ("HOPELESS",),
        f"{COMPETITION}:hopeless",
        lambda _own, _s, screened, _before: not screened,
    ),
    Gate(
        "loud",
        "one joint's loss alone keeps a search going",
        ("LOUD",),
        f"{NULL}:Floor.loud",
        numbers(LOUD=INF),
    ),
    Gate(
        "quiet",
        "a mean loss a little above that of noise is noise",
        ("AT_NOISE",),
        f"{COMPETITION}:only_noise",
        numbers(AT_NOISE=1.0),
    ),
    Gate(
        "standing out",
        "several windows that stand out keep a search going",
        ("SEVERAL", "ORDINARY", "OUTLYING", "CLEARLY"),
        f"{COMPETITION}:only_noise",
        numbers(SEVERAL=10**9),
    ),
    Gate(
        "at the floor",
        "a search ends at what a true hypothesis would leave, by simulation",
        ("SETTLED",),
        f"{COMPETITION}:at_floor",
        fixed(False),
        something,
    ),
    Gate(
        "every joint",
        "friction, damping and rotor inertia are tried in every joint at once",
        ("AFTER", "REMAINS"),
        "selection.all_joints:everywhere",
        given(1),
        changed(1),
    ),
    Gate(
        "closer forms",
        "it is asked whether dry friction gives way before it slides, a payload has an extent, a spring hardens",
        (),
        "selection.closer_forms:closer",
        given(1),
        changed(1),
    ),
    Gate(
        "as given",
        "masses near the given ones take the place of effects that are no likelier",
        (),
        "selection.given_masses:as_given",
        given(1),
        changed(1),
    ),
    Gate(
        "may be none",
        "effects of which the interval that is reported holds that there is none go, or are in doubt",
        (),
        f"{CRITERIA}:may_be_none",
        fixed([]),
        lambda answer, *_args: bool(answer),
    ),
    Gate(
        "pruned",
        "effects that later ones make needless go",
        ("WEAKEST",),
        "selection.backward_elimination:prune",
        given(1),
        changed(1),
    ),
    Gate(
        "likely",
        "what several other joints have too is likely at a further one",
        ("ELSEWHERE",),
        "selection.backward_elimination:elsewhere",
        fixed(0),
    ),
    Gate(
        "exchanged",
        "an effect gives way to an alternative that predicts better",
        ("EXCHANGES",),
        f"{ALTERNATIVES}:better_rival",
        fixed(None),
    ),
    Gate(
        "richer",
        "laws that contain a plain friction are fitted from where it stands",
        ("RICHER", "SETTLED"),
        f"{ALTERNATIVES}:_richer",
        fixed([]),
        lambda answer, *_: bool(answer),
    ),
    Gate(
        "contained",
        "a law that contains the chosen one is no tie",
        (),
        f"{ALTERNATIVES}:_contains",
        fixed(False),
    ),
    Gate(
        "same in principle",
        "effects that no motion tells apart tie always",
        (),
        "evidence.same_in_principle:same",
        fixed(False),
    ),
    Gate(
        "longer windows",
        "where nothing was found or something is left, longer windows are looked at",
        ("ENOUGH_WINDOWS",),
        "selection.procedure:_on_longer_windows",
        lambda _own, _p, s, f, rivals, *_args: (f, rivals, s),
        # what is left shows in them too
        lambda answer, _p, s, *_args: answer[2] is not s,
    ),
    Gate(
        "adding",
        "effects with which far more force is missing than without go",
        ("SURELY", "LARGER", "USUALLY"),
        "selection.confirmation:_adds",
        fixed(0.0),
        lambda answer, *_args: answer > USUALLY,
    ),
    Gate(
        "beside unknown",
        "where an unknown force explains far more than what was named, effects are searched for beside it",
        ("REMAINS",),
        "verdict.beside_unknown:beside_unknown",
        lambda _own, _p, _s, found, held, _say: (found, held),
        lambda answer, _p, _s, found, *_args: answer[0] is not found,
    ),
    Gate(
        "given up",
        "effects go beside which a function of what has no name could not be told, or with which its error is larger",
        ("REMAINS",),
        "verdict.beside_functions:without_needless",
        lambda _own, _p, _s, found, _at, functions, *_args: (found, functions),
        lambda answer, _p, _s, found, *_args: answer[0] is not found,
    ),
    Gate(
        "steps as seen",
        "effects are confirmed by predictions in the timestep and integrator that recordings show",
        ("SEEN", "MOST_SEEN"),
        "evidence.numerics_seen:amounts_seen",
        fixed({}),
    ),
    Gate(
        "chosen by others",
        "effects that recordings for choosing do not gain by go",
        ("SURE",),
        "selection.confirmation:confirmed",
        confirmed_without("choice"),
        went("choice"),
    ),
    Gate(
        "tested",
        "effects that test recordings do not gain by go",
        ("SURE",),
        "selection.confirmation:confirmed",
        confirmed_without("test"),
        went("test"),
    ),
    Gate(
        "doubt",
        "an excess over what noise leaves within so many standard errors is none",
        ("DOUBT",),
        f"{NULL}:Floor.exceeded",
        numbers(DOUBT=0.0),
    ),
    Gate(
        "far windows",
        "several windows far beyond the floor are more than noise",
        ("BEYOND_NOISE", "BY_CHANCE"),
        f"{NULL}:Floor.far",
        fixed(False),
    ),
    Gate(
        "finer steps",
        "with contacts the floor is that of finer steps where it is higher",
        (),
        f"{NULL}:floor",
        one_truth,
        lambda _answer, p, *_args, **_options: bool(p.ctx.contacts),
    ),
    Gate(
        "other starts",
        "what strikes may start elsewhere within its uncertainty",
        ("ELSEWHERE_FROM", "MANY_ELSEWHERE"),
        "estimation.initial_states:settled",
        given(2),
        lambda answer, _sim, _f, w, *_args, **_options: answer is not w,
    ),
    Gate(
        "too far from nothing",
        "a large error is not nothing, whatever the search found",
        ("FAR",),
        "verdict.judgement:too_far",
        fixed(False),
    ),
    Gate(
        "slight",
        "a slight share of the squared error that is left is told beside the effects",
        ("SLIGHT", "MEANS_SOMETHING"),
        "verdict.judgement:matters",
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
    "selection.alternatives": ("ITERATIONS", "ALONE"),
    "selection.backward_elimination": ("HALF",),
    "selection.closer_forms": ("ITERATIONS", "IN_COMMON"),
    "selection.competition": ("KEEP", "KEEP_OF_MANY"),
    "selection.confirmation": ("ITERATIONS", "SHORT"),
    "selection.forward_selection": ("REST",),
    "selection.given_masses": ("ITERATIONS", "TOGETHER"),
    "selection.procedure": ("REFINED",),
    "selection.search_state": ("MANY", "WORK"),
    "selection.setup": ("POOL", "FEWEST_ROWS"),
    "evidence.folds": ("FOLDS", "RECORDINGS"),
    "evidence.null_distribution": ("SEGMENT", "ROWS", "ALL", "SEGMENTS", "WITHIN"),
    "evidence.same_in_principle": ("PARALLEL",),
}
"""Numbers that stand in the rooms that decide and decide nothing: how much is tried or shown (candidates, windows,
iterations), how wide intervals are."""
