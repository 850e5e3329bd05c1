"""Machines that lack something everywhere: friction, damping and rotor inertia in every joint, or one effect of every
drive, all at once, then fewer.

A forward search adds one effect at a time, so that on an arm of many joints the first ones stand for what is missing
elsewhere (a delay for friction and rotor inertia behind a servo). Where several joints each still move otherwise than
noise lets them, or several effects were found and the rest is still more than noise, or the search would end with more
than noise left, the opposite direction is tried: all of the plain effects of joints, and a mass that some body may
carry besides, fitted together, and those that are not needed taken away. So are drives that have one thing in common:
commands that pass one bus come late together, one supply makes all of them weaker, and motors of one make lag alike, or
do nothing for a slight command.
"""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.candidates import compatible
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit
from mpge_jax.diagnosis.estimation.screening import ELABORATE, PLAIN
from mpge_jax.diagnosis.estimation.whitening import Whitener, robust_loss, usual_excess
from mpge_jax.diagnosis.evidence.scored import clearly_worse
from mpge_jax.diagnosis.selection.closer_forms import in_common_forms
from mpge_jax.diagnosis.selection.competition import at_noise, loud_in
from mpge_jax.diagnosis.selection.criteria import missed, needed, strength
from mpge_jax.diagnosis.selection.given_masses import with_given
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.thresholds import AFTER, NAMED, REMAINS

IN_EVERY_JOINT = ("coulomb_friction", "armature", "viscous_damping")
IN_EVERY_DRIVE = ("actuator_delay", "actuator_lag", "actuator_gain", "actuator_deadzone")
LATE_AND_WEAK = (("actuator_delay", "actuator_gain"), ("actuator_lag", "actuator_gain"))
"""What all drives may lack at once, beside what joints do."""
LOAD = "payload_mass"
ITERATIONS = 5


def everywhere(s: Search, current: Fitted) -> Fitted:
    """`current`, or a hypothesis with plain effects in every joint that predicts held-out windows clearly better."""
    # where a motor bounces in its gap, the rest is more than noise though nothing is missing
    if current.hypothesis.rugged or at_noise(s, current, s.whiten_one(current, s.train)):
        return current
    white = s.whiten_one(current, s.train)
    # fewer of them explain less than all do, which may not be at their best yet: half the way must be done
    now = usual_excess(evaluate(s.sim, [current], s.train, white)[0].loss)
    most = float(robust_loss(np.array(0.5 * (1.0 + REMAINS) * now)))
    told = _by_forces(s, white)
    fits = _promising(s, told, white, most)
    if not _any_at_noise(s, fits):
        together = _together(s, current, white, most)
        told, fits = told + together, fits + _promising(s, together, white, most)
    if not told:
        return current
    s.looked = True
    fits = _all_thinned(s, fits)
    fits = [f for f in fits if 0 < len(f.hypothesis.named) <= s.max_terms]
    if not fits:
        return current
    whites = s.whiten(min(fits, key=lambda f: f.loss))
    old = fit(s.sim, [current], s.train, whites[0], iterations=4)[0]
    *scored, before = s.score([*fits, old], whites)
    best = min(scored, key=lambda r: r.losses.mean())
    chosen = min((r for r in scored if not clearly_worse(r, best)), key=lambda r: r.complexity)
    s.log.append(
        f"everywhere: base {before.losses.mean():.3f}; "
        + "; ".join(f"{r.fit.hypothesis} {r.losses.mean():.3f}/{r.directions}" for r in scored)
    )
    # each by itself may be weak; what nobody knows leaks into all joints, and little of it goes away by that
    now, then = (usual_excess(float(r.losses.mean())) for r in (chosen, before))
    return chosen.fit if now < REMAINS * then and needed(chosen, before) else current


def _promising(s: Search, fits: list[Fitted], white: Whitener, most: float) -> list[Fitted]:
    """Those with less than the `most` loss, in the forms that effects have alike in the whole machine: in a wrong one
    of what all joints have, further effects stand for what that leaves."""
    formed = [in_common_forms(s, f) for f in fits if f.loss < most]
    return evaluate(s.sim, formed, s.train, white)


def _any_at_noise(s: Search, fits: list[Fitted]) -> bool:
    return any(at_noise(s, f, s.whiten_one(f, s.train)) for f in fits)


def _by_forces(s: Search, white: Whitener) -> list[Fitted]:
    """What the forces of drives say is missing, fitted to the motion."""
    if s.by_forces is None:
        return []
    s.say("asking what the forces of drives say is missing")
    told = s.by_forces()
    if told is None:
        return []
    told = told.of_terms(s.sim.ctx, Hypothesis.of(*(t for t in told.hypothesis.terms if t in s.terms)))
    return fit(s.sim, [told], s.train, white, iterations=8)


def _together(s: Search, current: Fitted, white: Whitener, most: float) -> list[Fitted]:
    """Effects in every joint or drive on top of what is known, fitted at once, as long as they may get below the `most`
    loss."""
    joints = [*(_with_all(s, current, keep) for keep in (False, True)), _with_all_laws(s, current)]
    drives = [_with_every_drive(s, current, (effect,)) for effect in IN_EVERY_DRIVE]
    starts = [f for f in (*joints, *drives) if f is not None]
    if not starts:
        return []
    s.say("trying friction, damping and rotor inertia in every joint, and what drives have in common")
    fits = fit(s.sim, starts, s.train, white, iterations=8, goal=most)
    if _any_at_noise(s, [f for f in fits if f.loss < most]):
        return fits
    both = [_with_every_drive(s, joints[0] or current, effects) for effects in LATE_AND_WEAK]
    better = sorted((f for f in both if f is not None), key=lambda f: f.loss)[:1]
    fits += fit(s.sim, better, s.train, white, iterations=8, goal=most) if better else []
    fits[0] = _with_load(s, fits[0], white, most)
    # where every joint lacks something, the masses were hardly weighed either
    free = with_given(s, fits[0])
    return fits + ([] if free is None else fit(s.sim, [free], s.train, white, iterations=8, goal=most))


def due(s: Search, current: Fitted) -> bool:
    """Whether it is time for that look, if it was not done."""
    if s.looked:
        return False
    if len(current.hypothesis.terms) == AFTER:
        return True
    return int(loud_in(s, current, s.train).sum()) >= AFTER


def _with_all(s: Search, current: Fitted, keep: bool) -> Fitted | None:
    """`current` with every plain effect of joints added; unless `keep`, without its effects of timing and its elaborate
    laws of friction, for which plain effects may have been mistaken. None where that adds or keeps nothing."""
    ctx = s.sim.ctx
    parts = dict(current.hypothesis.split(ctx, current.theta))
    doubtful = {t for t in parts if t.plain in ELABORATE or any(p.unit == "s" for p in t.params(ctx))}
    if keep and not doubtful:
        return None
    hypothesis = Hypothesis.of(*(t for t in parts if keep or t not in doubtful))
    known = len(hypothesis.terms)
    for term in s.terms:
        if term.id in IN_EVERY_JOINT and term.place.kind == "joint" and compatible(hypothesis, term):
            hypothesis = hypothesis.with_term(term)
            parts[term] = np.asarray(term.effect.starts(ctx, term.place))[0]
    if len(hypothesis.terms) == known:
        return None
    return Fitted.start(ctx, {t: parts[t] for t in hypothesis.terms})


def _with_all_laws(s: Search, current: Fitted) -> Fitted | None:
    """`current` with all plain laws of friction at every joint that has one of them: for two of them together a third
    may have been mistaken (viscous damping for dry friction and drag). None where none is to be added."""
    rubbing = {t.place for t in current.hypothesis.terms if t.id in PLAIN}
    hypothesis = current.hypothesis
    for term in s.terms:
        if term.id in PLAIN and term.place in rubbing and compatible(hypothesis, term):
            hypothesis = hypothesis.with_term(term)
    if hypothesis == current.hypothesis:
        return None
    ctx = s.sim.ctx
    parts = {t: t.effect.null(ctx, t.place) for t in hypothesis.terms}
    return Fitted.start(ctx, parts | current.hypothesis.split(ctx, current.theta))


def _with_load(s: Search, f: Fitted, white: Whitener, most: float) -> Fitted:
    """`f`, or with a mass more at the body where that promises most, if windows are predicted better with it."""
    loads = [t for t in s.terms if t.id == LOAD and compatible(f.hypothesis, t)]
    found = s.screened(f, s.sample(f, white), loads) if loads else []
    if not found:
        return f
    (loaded,) = fit(s.sim, found[:1], s.train, white, iterations=8, goal=most)
    more, less = s.score([loaded, f], s.whiten(loaded))
    return loaded if needed(more, less) else f


def _with_every_drive(s: Search, current: Fitted, effects: tuple[str, ...]) -> Fitted | None:
    """`current` without its effects of timing and with effects of every drive, each of them as large in all, by the
    starting values with which least is left. None with fewer than two drives for them."""
    ctx = s.sim.ctx
    parts = dict(current.hypothesis.split(ctx, current.theta))
    timing = {t for t in parts if any(p.unit == "s" for p in t.params(ctx))}
    best = current.of_terms(
        ctx, Hypothesis.of(*(t for t in parts if t not in timing and t.id not in effects))
    )
    white = s.whiten_one(current, s.train)
    for effect in effects:
        hypothesis = best.hypothesis
        drives = [
            t for t in s.terms if t.id == effect and t.place.kind == "actuator" and compatible(hypothesis, t)
        ]
        if len(drives) < 2:
            return None
        parts = dict(hypothesis.split(ctx, best.theta))
        starts, fits = {t: np.asarray(t.effect.starts(ctx, t.place)) for t in drives}, []
        for k in range(max(map(len, starts.values()))):
            parts |= {t: x[min(k, len(x) - 1)] for t, x in starts.items()}
            fits.append(Fitted.start(ctx, parts))
        best = min(evaluate(s.sim, fits, s.train, white), key=lambda f: f.loss)
    return best


def _all_thinned(s: Search, fits: list[Fitted]) -> list[Fitted]:
    """Each of some fits without what it does not need, those of few effects first, but those that predict held-out
    windows no better than what is left of another one."""
    out: list[Fitted] = []
    for f in sorted(fits, key=lambda f: len(f.hypothesis.terms)):
        if out:
            whole, *others = s.score([f, *out], s.whiten(f))
            if not all(needed(whole, r) for r in others):
                continue
        out.append(_thinned(s, f))
    return out


def _thinned(s: Search, f: Fitted) -> Fitted:
    """`f` without what windows are predicted as well without. Of the terms that the data do not tell from null the
    weaker half is taken away at once, and the rest is fitted again: what one of two like effects explains, the other
    must be free to take over. Where that half is missed, by what is left or by the best that there was, half of it is
    tried, and so on."""
    best: Fitted | None = None
    while f.hypothesis.terms:
        whites = s.whiten(f)
        f = fit(s.sim, [f], s.train, whites[0], iterations=ITERATIONS)[0]
        size = strength(s, f)
        weak = sorted((t for t in size if size[t] < NAMED), key=lambda t: size[t])
        count = (len(weak) + 1) // 2
        while count:
            kept = Hypothesis.of(*(t for t in f.hypothesis.terms if t not in weak[:count]))
            fewer = fit(s.sim, [f.of_terms(s.sim.ctx, kept)], s.train, whites[0], iterations=ITERATIONS)[0]
            less, *more = s.score([fewer, f] if best is None else [fewer, f, best], whites)
            if not any(missed(r, less) for r in more):
                f, best = fewer, min(more, key=lambda r: r.losses.mean()).fit
                break
            count //= 2
        else:
            return f
    return f
