"""Screening: one linearised step for every effect at every place, checked by simulation."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.effects.context import Context, Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted, prior_loss
from mpge_jax.diagnosis.estimation.levenberg_marquardt import Slopes, slopes_of
from mpge_jax.diagnosis.estimation.parameter_steps import Problem, beyond, promise, proposals
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss
from mpge_jax.diagnosis.machine.model import actuators_of_joint
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.cheaper_steps import Near
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray


ELABORATE = (
    "stribeck_friction",
    "load_dependent_friction",
    "load_dependent_friction:gear",
    "asymmetric_friction",
)
"""Laws of friction that contain plain ones as special cases."""
WHERE_PLAIN_HELPS = (*ELABORATE, "viscous_damping:explicit")
"""What is tried where a plain law of friction helps."""
PLAIN = ("coulomb_friction", "viscous_damping", "quadratic_drag")
"""Laws of friction that contain no other."""
PLACES = 3
"""Places at which the elaborate laws are tried: where plain ones help most; and joints at which gaps are: where
anything does."""
PROMISING = 0.01
"""Share of the loss that a linearised step must promise to be simulated, and a quick fit keep to be fitted further."""
NEARER = 0.1
"""How much nearer to nothing a start is taken that is worse than nothing."""
NEARER_TIMES = 2
"""How often that is done where there are contacts: through impacts only slight changes can be followed."""
LEADING = 3
"""Starting values of one term whose slopes are simulated: those that explain most by themselves."""
STARTS = 2
"""Starting values of one term from which steps are simulated: those that promise most."""


def screen(
    sim: Simulator,
    base: Fitted,
    terms: list[Term],
    w: Windows,
    white: Whitener,
    slopes: Slopes | None = None,
) -> list[Fitted]:
    """Best quick fit of `base` plus each term, lowest loss first.

    Every start of every term is simulated, the best ones are linearised once, with the base's parameters free, and two
    step lengths are simulated where the linear model promises anything. The base's own Jacobian is shared by all.
    Elaborate laws of friction, and second forms of plain ones, are tried where a plain one helps; gaps in drives, each
    of which takes as long as ten others, where anything else at the joint or its drives does.

    Args:
        slopes: of the base (`slopes_of`), if they are known.
    """
    near = Near.to(sim, Run(base.hypothesis, base.theta), w)
    own = slopes_of(sim, base, w, white) if slopes is None else slopes
    before = float(
        robust_loss(white.excess(_whitened(near, [Run(base.hypothesis, base.theta)], white))).mean()
    )
    elaborate = [t for t in terms if t.id in WHERE_PLAIN_HELPS]
    gaps = [t for t in terms if t.effect.rugged]
    always = [t for t in terms if t.id not in WHERE_PLAIN_HELPS and not t.effect.rugged]
    found = _quick_fits(near, base, always, white, own, before)
    parts = [(f.loss, f.hypothesis.split(sim.ctx, f.theta)) for f in found]
    told = {t: loss for loss, its in parts for t in its if t not in base.hypothesis.terms}
    known = {t: its[t] for _, its in parts for t in its if t in told and t.id in PLAIN}
    plain = _least((t.place, told[t]) for t in known)
    anything = _least(
        (gap.place, told[t]) for gap in gaps for t in told if _at_its_joint(sim.ctx, t.place, gap.place)
    )
    limit = _promising(before)
    further = _where_it_helps(elaborate, plain, limit) + _where_it_helps(gaps, anything, limit)
    found += _quick_fits(near, base, further, white, own, before, known)
    return sorted(found, key=lambda f: f.loss)


def _least(losses: Iterable[tuple[Place, float]]) -> dict[Place, float]:
    """The least loss at each place."""
    out: dict[Place, float] = {}
    for place, loss in losses:
        out[place] = min(out.get(place, np.inf), loss)
    return out


def _where_it_helps(terms: list[Term], losses: dict[Place, float], limit: float) -> list[Term]:
    """The terms at the places with the least losses below a limit, or where nothing was tried."""
    places = [q for q in sorted(losses, key=lambda q: losses[q]) if losses[q] < limit][:PLACES]
    return [t for t in terms if t.place in places or t.place not in losses]


def _at_its_joint(ctx: Context, place: Place, joint: Place) -> bool:
    """Whether a place is a joint or one of its actuators."""
    return place == joint or (
        place.kind == "actuator" and place.index in actuators_of_joint(ctx.model, joint.index)
    )


def better_beside(
    sim: Simulator,
    base: Fitted,
    terms: list[Term],
    sample: tuple[Windows, Whitener],
    slopes: Slopes,
    than: float,
    known: dict[Term, Array],
) -> list[Fitted]:
    """Best quick fit of `base` plus each term, of those that are worth more than a loss, lowest loss first.

    Args:
        slopes: of the base (`slopes_of`). known: parameters of plainer terms, which each begins beside.
    """
    near = Near.to(sim, Run(base.hypothesis, base.theta), sample[0])
    found = _quick_fits(near, base, terms, sample[1], slopes, than, known)
    return sorted((f for f in found if f.loss < _promising(than)), key=lambda f: f.loss)


def _quick_fits(
    near: Near,
    base: Fitted,
    terms: list[Term],
    white: Whitener,
    own: Slopes,
    before: float,
    known: dict[Term, Array] | None = None,
) -> list[Fitted]:
    """The best quick fit of each term.

    Args:
        own: the base's Jacobian. before: the base's loss. known: parameters of plainer terms.
    """
    ctx, w = near.sim.ctx, near.w
    problems = _starting_points(near, base, terms, white, before, known or {})
    runs: list[Run] = []
    for term, p in problems:
        part = _slice(ctx, p.fit.hypothesis, term)
        steps = p.steps()
        for i in range(part.start, part.stop):
            moved = p.fit.theta.copy()
            moved[i] += steps[i]
            runs.append(Run(p.fit.hypothesis, moved))
    flat = _whitened(near, runs, white)
    k = 0
    promised: dict[Term, list[tuple[float, int, list[Array]]]] = {}
    for index, (term, p) in enumerate(problems):
        hypothesis = p.fit.hypothesis
        slices = dict(zip(hypothesis.terms, hypothesis.slices(ctx), strict=True))
        part, steps = slices[term], p.steps()
        jacobian = np.zeros((len(p.params), *p.whitened.shape), dtype=np.float32)
        for other, columns in own.items():
            jacobian[slices[other]] = columns
        n = part.stop - part.start
        jacobian[part] = (flat[k : k + n] - p.whitened) / steps[part, None, None]
        k += n
        p.jacobian = jacobian
        if p.params:
            steps_to = proposals(p, ctx)
            hope = min((promise(p, t, w, white) for t in steps_to), default=np.inf)
            promised.setdefault(term, []).append((hope, index, steps_to))
        p.jacobian = np.zeros((0, 0))
    trials: list[tuple[int, Array]] = []
    for term, entries in promised.items():
        for hope, index, steps_to in sorted(entries, key=lambda e: e[0])[:STARTS]:
            if term.effect.jagged or hope < _promising(before):
                further = [x for t in steps_to[:1] for x in beyond(problems[index][1], t, ctx)]
                trials += [(index, t) for t in [*steps_to, *further]]
    outcome = _whitened(near, [Run(problems[i][1].fit.hypothesis, t) for i, t in trials], white)
    for (i, theta), r in zip(trials, outcome, strict=True):
        p = problems[i][1]
        x = white.excess(r)
        loss = float(robust_loss(x).mean()) + prior_loss(p.params, theta, p.fit.centre, *r.shape)
        if loss < p.fit.loss:
            p.fit = replace(p.fit, theta=theta, loss=loss, x=x)
    best: dict[Term, Fitted] = {}
    for term, p in problems:
        if term not in best or p.fit.loss < best[term].loss:
            best[term] = p.fit
    return list(best.values())


def _promising(before: float) -> float:
    """Loss below which a step from another loss is one."""
    return before - PROMISING * min(before, 3.0)


def _slice(ctx: Context, hypothesis: Hypothesis, term: Term) -> slice:
    return hypothesis.slices(ctx)[hypothesis.terms.index(term)]


def _starting_points(
    near: Near,
    base: Fitted,
    terms: list[Term],
    white: Whitener,
    before: float,
    known: dict[Term, Array],
) -> list[tuple[Term, Problem]]:
    """The best starts of every term, simulated, its own and those at which it does what plainer terms do.

    A start that is worse than nothing, as its scale was guessed too large, gives way to one nearer to where the
    effect vanishes if that is better.
    """
    ctx = near.sim.ctx
    parts = base.hypothesis.split(ctx, base.theta)
    problems: list[tuple[Term, Problem]] = []
    for term in terms:
        for own in starts_beside(ctx, term, known):
            begun = Fitted.start(ctx, {**parts, term: own})
            problems.append((term, Problem(begun, begun.hypothesis.params(ctx))))
    _simulate([p for _, p in problems], near, white)
    first = [p.fit.theta for _, p in problems]
    for times in range(1, (NEARER_TIMES if ctx.contacts else 1) + 1):
        smaller: list[tuple[Problem, Problem]] = []
        for (term, p), start in zip(problems, first, strict=True):
            naming = term.effect.naming(ctx, term.place)
            if p.fit.loss < before + PROMISING * min(before, 3.0) or not naming:
                continue
            part = _slice(ctx, p.fit.hypothesis, term)
            null, theta = term.effect.null(ctx, term.place), start.copy()
            theta[part][naming] = null[naming] + NEARER**times * (start[part][naming] - null[naming])
            smaller.append((p, Problem(Fitted(p.fit.hypothesis, theta, theta.copy()), p.params)))
        _simulate([q for _, q in smaller], near, white)
        for p, q in smaller:
            if q.fit.loss < p.fit.loss:
                p.fit, p.whitened = q.fit, q.whitened
    return _leading(problems)


def _leading(problems: list[tuple[Term, Problem]]) -> list[tuple[Term, Problem]]:
    """The best few starts of each term, in their order."""
    ranked: dict[Term, list[float]] = {}
    for term, p in problems:
        ranked.setdefault(term, []).append(p.fit.loss)
    worst = {term: sorted(losses)[:LEADING][-1] for term, losses in ranked.items()}
    return [(term, p) for term, p in problems if p.fit.loss <= worst[term]]


def starts_beside(ctx: Context, term: Term, known: dict[Term, Array]) -> Array:
    """Starts [k, p] of a term: its own, of a law of friction with its torques as large as plain dry friction, of which
    it is a variant; and those at which it does what plainer terms at its place do, than which it is then no worse.

    Args:
        known: parameters of plainer terms.
    """
    plainer = {t.id: theta for t, theta in known.items() if t.place == term.place}
    starts, dry = term.effect.starts(ctx, term.place), float(plainer.get("coulomb_friction", [0.0])[0])
    torque = np.array([p.unit in ("N m", "N") for p in term.params(ctx)])
    if dry > 0.0 and torque.any():
        starts = np.where(torque, starts * dry / term.params(ctx)[0].scale, starts)
    alike = [term.effect.containing(ctx, term.place, name, theta) for name, theta in plainer.items()]
    return np.concatenate([starts, *alike])


def _simulate(problems: list[Problem], near: Near, white: Whitener) -> None:
    flat = _whitened(near, [Run(p.fit.hypothesis, p.fit.theta) for p in problems], white)
    for p, r in zip(problems, flat, strict=True):
        x = white.excess(r)
        p.whitened, p.fit = r, replace(p.fit, x=x, loss=float(robust_loss(x).mean()))


def _whitened(near: Near, runs: list[Run], white: Whitener) -> Array:
    """Whitened residuals [R, W, M] in single precision, made in pieces to save memory."""
    out = np.empty((len(runs), near.w.count, white.seen.shape[1]), dtype=np.float32)
    for a in range(0, len(runs), 64):
        out[a : a + 64] = white(near.residuals(runs[a : a + 64]))
    return out
