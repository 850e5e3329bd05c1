"""Alternatives to each chosen effect: why they lost, and which of them the data cannot tell apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.context import Context, Place
from mpge_jax.diagnosis.effects.friction.dry import CREEPING
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.covariance import WITHIN
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import Slopes, evaluate, fit, slopes_of
from mpge_jax.diagnosis.estimation.screening import ELABORATE, better_beside
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss
from mpge_jax.diagnosis.evidence.common_delay import by_a_common_delay
from mpge_jax.diagnosis.evidence.common_factor import by_a_common_factor
from mpge_jax.diagnosis.evidence.friction_by_direction import by_direction
from mpge_jax.diagnosis.evidence.joints_of_place import first_joints, next_to
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt, log_ratio, odds
from mpge_jax.diagnosis.evidence.rigid_equivalence import carried_over, same_body
from mpge_jax.diagnosis.evidence.same_in_principle import same
from mpge_jax.diagnosis.evidence.scored import Rival, Scored, evidence, hopeful
from mpge_jax.diagnosis.selection.competition import KEEP_OF_MANY
from mpge_jax.diagnosis.selection.criteria import named, needed, strength
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.windows import Windows
from mpge_jax.diagnosis.thresholds import RICHER, SETTLED

SPECIAL_CASES = {
    "coulomb_friction": ELABORATE,
    CREEPING: ELABORATE,
    "viscous_damping": ("asymmetric_friction",),
    "viscous_damping:explicit": ("asymmetric_friction",),
    "dead_actuator": (
        "actuator_gain",
        "actuator_gain:limited",
        "torque_saturation",
        "actuator_deadzone",
        "actuator_deadzone:limited",
    ),
}
"""Plain effects and the elaborate ones that contain them at the same place: those always fit as well."""
ITERATIONS, ALONE = 8, 3
"""Steps of the fit of what comes near, most of which ends before: hypotheses are compared each at its own best. And
those before that of what stands in an effect's place alone."""
NOTHING_WEIGHED: Mapping[Term, list[Rival]] = MappingProxyType({})
FEWER = "it explains as much with fewer effects"
PLAIN_LAWS = ("coulomb_friction", CREEPING, "viscous_damping", "viscous_damping:explicit")


def find_rivals(
    s: Search,
    best: Scored,
    whites: tuple[Whitener, Whitener],
    known: list[Scored],
    keep: int = 6,
    weighed: Mapping[Term, list[Rival]] = NOTHING_WEIGHED,
) -> dict[Term, list[Rival]]:
    """Rivals of every term, nearest first. Beside many effects, only what acts at the same joint is weighed against
    each, and the same effect at the next body: what acts elsewhere was compared while they were chosen.

    Args:
        best: the chosen fit, scored under `whites`. known: fits of single effects from the search, reused where
            the chosen hypothesis has one term. weighed: rivals that stand (`unaffected`).
    """
    hypothesis = best.fit.hypothesis
    keep = KEEP_OF_MANY if s.brief(hypothesis) else keep
    slopes = slopes_of(s.sim, best.fit, s.train, whites[0])
    fitted = {k.fit.hypothesis: k.fit for k in known if len(hypothesis.terms) == 1}
    out: dict[Term, list[Rival]] = {}
    at_once: dict[Hypothesis, Scored] = {}
    for term in hypothesis.named:
        if term in weighed:
            out[term] = weighed[term]
            continue
        s.say(f"weighing alternatives to {term}")
        without = hypothesis.without(term)
        rivals = []
        for r in s.score(_instead(s, best, whites[0], term, fitted, keep, slopes), whites):
            other = next((t for t in r.fit.hypothesis.terms if t not in without.terms), None)
            if other is not None:
                rivals.append(_compare(s, best, term, r, other))
        rivals += _all_at_once(s, best, whites, term, at_once)
        out[term] = _one_each(sorted(rivals, key=lambda r: r.margin))
    return out


def _instead(
    s: Search,
    best: Scored,
    white: Whitener,
    term: Term,
    fitted: Mapping[Hypothesis, Fitted],
    keep: int,
    slopes: Slopes,
) -> list[Fitted]:
    """Fits with something else in place of a term: the `keep` most promising ones.

    Args:
        white: of the training windows. fitted: what need not be fitted again. slopes: of the chosen fit in these.
    """
    ctx, hypothesis = s.sim.ctx, best.fit.hypothesis
    without, many = hypothesis.without(term), s.brief(hypothesis)
    base = best.fit.exchanged(ctx, [term], {})
    sample = s.sample(base, white)
    # Screened anew: the search drops what looks like a better one of its group, as a rival does.
    candidates = [t for t in s.terms if t.effect.named and not _same(t, term) and compatible(without, t)]
    if many:
        candidates = [t for t in candidates if _near(ctx, term, t)]
    beside = slopes_of(s.sim, base, *sample)
    screened = s.screened(base, sample, candidates, beside)
    alike = {without.with_term(t) for t in candidates if same(ctx, term, t)}
    pool = screened[:keep] + [r for r in screened[keep:] if r.hypothesis in alike]
    pool = [fitted.get(r.hypothesis, r) for r in pool]
    fits = fit(s.sim, pool, *sample, iterations=2, slopes=beside, anew=False)
    if fits:
        # what comes near is judged on all windows, so it is fitted to them
        near = hopeful(fits, evaluate(s.sim, [base], *sample)[0].loss)
        if many:
            near = [f for f in near if not _contains(f, without, term)]
        near += [f for f in fits if f.hypothesis in alike - {x.hypothesis for x in near}]
        near += [f for t in candidates if (f := carried_over(ctx, best.fit, term, t)) is not None]
        near = _beside_the_same(s, best.fit, near, sample)
        if many and near:
            # nor what is worse there already than what was chosen
            nearest = min([*near, *evaluate(s.sim, [best.fit], *sample)], key=lambda f: f.loss)
            near = [f for f in near if f.hypothesis in alike or not _worse(f, nearest)]
        settled = {f.hypothesis for f in near}
        far = [f for f in fits if f.hypothesis not in settled]
        fits = [*fit(s.sim, near, s.train, white, iterations=ITERATIONS, slopes=slopes), *far]
    unsettled = best.losses.mean() > SETTLED or best.factor > 1.0
    if term.id in PLAIN_LAWS and (unsettled or _pushed(ctx, hypothesis, term)):
        fits += _richer(s, best, base, white, sample, term, (beside, slopes))
    return fits


def _beside_the_same(
    s: Search, best: Fitted, fits: list[Fitted], sample: tuple[Windows, Whitener]
) -> list[Fitted]:
    """Fits, each with the effects of the best one as they are there and its own where it is best beside these, unless
    that is worse beyond doubt on a sample of windows: while its own was far from there, the others had given way.

    Args:
        fits: on that sample.
    """
    ctx, known = s.sim.ctx, best.hypothesis.split(s.sim.ctx, best.theta)
    starts = []
    for f in fits:
        parts = f.hypothesis.split(ctx, f.theta)
        starts.append(Fitted.start(ctx, {t: known.get(t, own) for t, own in parts.items()}))
    alone = fit(s.sim, starts, *sample, iterations=ALONE, anew=False, still=known)
    return [f if _worse(x, f) else x for f, x in zip(fits, alone, strict=True)]


def _worse(f: Fitted, than: Fitted) -> bool:
    """Whether the windows of both speak against `f` beyond doubt."""
    return bool(than.x.size) and beyond_doubt(log_ratio(robust_loss(f.x) - robust_loss(than.x)))


def _near(ctx: Context, term: Term, other: Term) -> bool:
    """Whether two terms act at the same joint, or are alike at bodies that are next to each other, or in principle."""
    m = ctx.model
    here = first_joints(m, term.place) & first_joints(m, other.place)
    return bool(here) or next_to(m, term, other) or same(ctx, term, other)


def unaffected(
    s: Search, rivals: Mapping[Term, list[Rival]], old: Hypothesis, new: Hypothesis
) -> dict[Term, list[Rival]]:
    """Rivals that stand though another hypothesis was chosen: beside many effects, of terms at joints at which nothing
    else acts now. Those that tied are weighed anew, as they are reported with all that is beside them."""
    if not (s.brief(old) and s.brief(new)):
        return {}
    changed = set(old.terms) ^ set(new.terms)
    joints = set[int]().union(*(first_joints(s.sim.ctx.model, t.place) for t in changed))
    return {
        t: its
        for t, its in rivals.items()
        if t in new.terms
        and not (joints & first_joints(s.sim.ctx.model, t.place))
        and not any(r.tied or r.better for r in its)
    }


def _all_at_once(
    s: Search, best: Scored, whites: tuple[Whitener, Whitener], term: Term, known: dict[Hypothesis, Scored]
) -> list[Rival]:
    """What ties with a term only together with others: all drives weaker with all masses times a factor, where nothing
    given resists, than which all masses are simpler; all commands late with all encoders late; dry friction and a
    constant force of the drive with friction that differs by direction.

    Args:
        known: what was fitted for an earlier term; what is fitted now is added.
    """
    out = []
    for in_its_place in (by_a_common_factor, by_a_common_delay, by_direction):
        other_way = in_its_place(s.sim.ctx, s.terms, best.fit, term)
        if other_way is None:
            continue
        start, (other, *beside) = other_way
        if start.hypothesis not in known:
            # what is known of a start means another thing where encoders are late
            its = (
                s.whiten_one(start, s.train, whites[0].factor),
                s.whiten_one(start, s.held, whites[1].factor),
            )
            (known[start.hypothesis],) = s.score(fit(s.sim, [start], s.train, its[0], iterations=6), its)
        rival = _compare(s, best, term, known[start.hypothesis], other, *beside, alike=True)
        simpler = in_its_place is by_a_common_factor and len(start.hypothesis.terms) < len(
            best.fit.hypothesis.terms
        )
        if simpler and not beyond_doubt(rival.margin):
            rival = replace(rival, why_not=FEWER, tied=False, better=True)
        out.append(rival)
    return out


def _richer(
    s: Search,
    best: Scored,
    base: Fitted,
    white: Whitener,
    sample: tuple[Windows, Whitener],
    term: Term,
    slopes: tuple[Slopes, Slopes],
) -> list[Fitted]:
    """The elaborate laws of friction that contain a plain one and promise more, fitted from where the latter stands:
    beside other effects, and through contacts, generic starts do not lead there.

    Args:
        base: the chosen fit without the plain one. slopes: of the others, on the sample and on all windows.
    """
    forms = [Term(i, term.place) for i in SPECIAL_CASES[term.id]]
    forms = [t for t in forms if t in s.terms and compatible(base.hypothesis, t)]
    plain = evaluate(s.sim, [best.fit], *sample)[0].loss
    plainest = Term("coulomb_friction", term.place) if term.id == CREEPING else term
    known = {plainest: best.fit.hypothesis.split(s.sim.ctx, best.fit.theta)[term]}
    begun = better_beside(s.sim, base, forms, sample, slopes[0], plain, known)
    told = fit(s.sim, begun, *sample, iterations=4, slopes=slopes[0], anew=False)
    promising = sorted(told, key=lambda f: f.loss)[:RICHER]
    return fit(s.sim, promising, s.train, white, iterations=4, slopes=slopes[1])


def _pushed(ctx: Context, h: Hypothesis, term: Term) -> bool:
    """Whether a bias acts at a joint that rubs: the two may be friction that differs by direction."""
    here = first_joints(ctx.model, term.place)
    return any(t.name == "actuator_bias" and first_joints(ctx.model, t.place) == here for t in h.terms)


def _same(a: Term, b: Term) -> bool:
    """Whether two terms are forms of one effect at one place."""
    return (a.name, a.place) == (b.name, b.place)


def _contains(f: Fitted, without: Hypothesis, term: Term) -> bool:
    """Whether a rival has `term` as a special case: it always fits as well, and is none to choose."""
    special = SPECIAL_CASES.get(term.id, ())
    return any(
        t.place == term.place and t.id in special for t in f.hypothesis.terms if t not in without.terms
    )


def better_rival(rivals: dict[Term, list[Rival]]) -> Rival | None:
    """The alternative that predicts clearly better than the term that it would replace, if there is one.

    Effects are added one at a time, so an early one may stand for another that shows only beside later ones (rotor
    inertia for a payload, before friction is known).
    """
    found = [r for rs in rivals.values() for r in rs if r.better]
    return min(found, key=lambda r: r.margin, default=None)


def _one_each(rivals: list[Rival]) -> list[Rival]:
    """The best form of every effect at its place; the forms of an effect are reported under one name."""
    best: dict[tuple[str, Place], Rival] = {}
    for r in rivals:
        key = (r.term.name, r.term.place)
        if key not in best or (r.tied and not best[key].tied):
            best[key] = r
    return sorted(best.values(), key=lambda r: r.margin)


def _compare(
    s: Search, best: Scored, term: Term, rival: Scored, other: Term, *beside: Term, alike: bool = False
) -> Rival:
    """How what has `other` in place of a term compares.

    Args:
        beside: what stands there with `other`. alike: whether it is the same motion in principle.
    """
    margin = evidence(best, rival)

    def of(why_not: str, tied: bool = False, better: bool = False) -> Rival:
        return Rival(other, rival.fit, margin, why_not, tied, better, beside)

    told_apart = named(s, rival.fit, best.fit.hypothesis.without(term))
    if told_apart and needed(rival, best, len(s.terms), max(len(beside), 1)):
        return of("it predicts better, but less simply", better=True)
    if beyond_doubt(margin):
        return of(f"it predicts worse ({odds(margin)} against it)")
    if same_body(s.sim.ctx, term, other):
        return of("it is the same rigid body under another name")
    if alike or (same(s.sim.ctx, term, other) and told_apart):
        return of("no recording of this machine can tell the two apart", tied=True)
    if _contains(rival.fit, best.fit.hypothesis.without(term), term):
        return of(
            f"it contains {term.name.replace('_', ' ')} as a special case and gains nothing by its further parameters"
        )
    if other.effect.tier > term.effect.tier:
        return of("it fits as well, but is the less direct explanation")
    if not told_apart:
        return of("the data do not determine its parameters")
    if rival.directions > best.directions:
        return of("it needs more free parameters for the same fit")
    if _needs_fewer(s, best.fit, rival.fit, term):
        return of(FEWER, better=True)
    return of("the data cannot tell the two apart", tied=True)


def _needs_fewer(s: Search, best: Fitted, rival: Fitted, term: Term) -> bool:
    """Whether an effect that is told beside a term may be nothing beside its rival: the two had stood for one."""
    here, there = strength(s, best), strength(s, rival)
    beside = [t for t in best.hypothesis.without(term).named if t in there]
    return any(there[t] < WITHIN < here[t] for t in beside)
