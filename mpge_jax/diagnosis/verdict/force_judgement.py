"""The verdict where the motion is given: which effects unseen forces need, and what is left of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.intervals import number
from mpge_jax.diagnosis.evidence.joints_of_place import acted_on
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt, odds
from mpge_jax.diagnosis.evidence.scored import Rival
from mpge_jax.diagnosis.force_balance.balance import Balance
from mpge_jax.diagnosis.force_balance.force_errors import ROWS, ForceErrors, errors_of, force_errors, rms
from mpge_jax.diagnosis.force_balance.procedure import ForceDecision, fitted
from mpge_jax.diagnosis.machine.model import is_joint_transmission
from mpge_jax.diagnosis.residual.forces import residual_of_forces
from mpge_jax.diagnosis.thresholds import SLIGHT
from mpge_jax.diagnosis.verdict.force_confirmation import confirmed, without
from mpge_jax.diagnosis.verdict.part_of_unknown import doubtful, left_beside
from mpge_jax.diagnosis.verdict.remainder_description import in_words
from mpge_jax.diagnosis.verdict.result import Result

Array = np.ndarray
NOISE, FINE = 1.5, 0.01
"""Error of a force over that of noise, and over the force itself, up to which nothing is left."""
BESIDE = 0.3
"""Share of the worst joint's remainder from which on another joint is named beside it."""
MOMENTS = 8
RIVALS = 3


def judge_forces(p: Prepared, found: ForceDecision, say: Callable[[str], None]) -> Result:
    """The verdict on what was found in the training recordings, by forces that nothing was fitted to."""
    say("judging what is left")
    resolution = found.balance.resolution
    test = Balance.recorded(p, p.test, ROWS, resolution)
    fit, warnings = confirmed(found.search.bank, found.fit, test, p.config.masses_within)
    held = errors_of(p, p.test, test, fit)
    p.warnings += warnings
    train = force_errors(p, p.looked_at, resolution, fit)
    rivals = {t: _rivals(found, fit, t) for t in fit.hypothesis.named}
    real, share = _left(held)
    unexplained, residual, beside = None, None, {}
    if real and (share > SLIGHT or not fit.hypothesis.named):
        unexplained = _describe(p, held, share)
        say("modelling what is left")
        residual = residual_of_forces(p, found.balance, fit, unexplained["at"], held)
        if residual is not None:
            unexplained["when"] = residual.told(unexplained["when"])
        parts = fit.hypothesis.split(p.ctx, fit.theta)
        each = {t: rms(without(test, parts, t) - test.telling) for t in parts}
        joints = [acted_on(p.model, Place("actuator", a, k)) for k, a in enumerate(p.names.actuators)]
        beside = left_beside(p, unexplained["at"], held.each_left, each, held.floors_left, joints)
    if unexplained is not None:
        verdict = "unexplained"
    elif any(r.tied for each in rivals.values() for r in each):
        verdict = "ambiguous"
    else:
        verdict = "effects" if fit.hypothesis.named else "none"
    drops = {t: _drop(held, fit, t) for t in fit.hypothesis.terms}
    return Result(
        verdict, p, fit, rivals, drops, train, held, _location(p, train), unexplained,
        list(dict.fromkeys(p.warnings)), p.config, found.search.log,
        remainder=share if real and unexplained is None else 0.0, residual=residual,
        doubtful=doubtful(beside, None),
    )  # fmt: skip


def _drop(held: ForceErrors, f: Fitted, term: Term) -> float:
    """Share of the squared error of held-out forces that goes with one effect, the others kept."""
    b = held.balance
    wrong = without(b, f.hypothesis.split(b.ctx, f.theta), term) - b.measured
    return float(1.0 - held.after**2 / max(float(np.nanmean(wrong**2)), 1e-300))


def _rivals(found: ForceDecision, fit: Fitted, term: Term) -> list[Rival]:
    """What could stand in an effect's place, nearest first. The same to these forces in principle, or too near to tell,
    is tied; what has more freedom always fits as well, and is not."""
    s, out = found.search, []
    # closer forms take the place of what was searched for
    searched = {(t.plain, t.place): t for t in found.found.rivals}
    was = searched.get((term.plain, term.place), term)
    reported = {(t.plain, t.place) for t in fit.hypothesis.terms}
    own = [e for e in found.found.best.chosen if e.term == was]
    for r in found.found.rivals.get(was, [])[:RIVALS]:
        (other,) = (e for e in r.chosen if e not in found.found.best.chosen)
        ratio = s.ratio(found.found.best, r)
        richer = s.directions(other) > sum(map(s.directions, own))
        tied = not beyond_doubt(ratio) and not richer
        parts = s.parts(r.chosen)
        parts = {t: x for t, x in parts.items() if t == other.term or (t.plain, t.place) in reported}
        f = fitted(s.bank, parts) if tied else Fitted.start(found.balance.ctx, parts)
        if tied and other.term not in f.hypothesis.terms:
            tied = False
        out.append(Rival(other.term, f, ratio, _why_not(ratio, richer, tied), tied))
    return out


def _why_not(ratio: float, richer: bool, tied: bool) -> str:
    if tied:
        return "these recordings cannot tell it apart"
    if not beyond_doubt(ratio) and richer:
        return "predicts other stretches no better, and has more freedom to fit"
    if not beyond_doubt(ratio):
        return "ends up as nothing when it is fitted with the others"
    return f"predicts other stretches worse ({odds(ratio)} against it)"


def _left(e: ForceErrors) -> tuple[bool, float]:
    """Whether more than noise is left, and its share of the squared error, actuators weighed by their forces."""
    size = e.size
    real = (e.each_left > NOISE * e.floors_left) & (e.each_left > FINE * size)
    left, whole = (
        float(np.nansum(np.maximum(x**2 - floor**2, 0.0) / size**2))
        for x, floor in ((e.each_left, e.floors_left), (e.each_before, e.floors))
    )
    return bool(real.any()), min(left / max(whole, 1e-300), 1.0)


def _describe(p: Prepared, e: ForceErrors, share: float) -> dict[str, Any]:
    """The `unexplained` entry of a diagnosis."""
    b, m, size = e.balance, p.model, e.size
    left = np.nan_to_num(np.maximum(e.each_left**2 - e.floors_left**2, 0.0) / size**2)
    order = [int(a) for a in np.argsort(-left) if left[a] >= BESIDE * left.max()]
    at = [p.names.driven_by(m, a) for a in order]
    worst = order[0]
    missing = b.telling[:, worst] - e.corrected[:, worst]
    seen = np.isfinite(missing)
    time, q, v = (np.concatenate([getattr(t, name) for t in b.tracks]) for name in ("time", "q", "v"))
    clues = {"time since the start": time, "size of the measured force": np.abs(b.measured[:, worst])}
    if is_joint_transmission(m, worst):
        joint = int(m.actuator_trnid[worst, 0])
        clues |= {
            "speed of the joint": np.abs(v[:, m.jnt_dofadr[joint]]),
            "angle of the joint": q[:, m.jnt_qposadr[joint]],
        }
    when = in_words(
        missing[seen], {k: x[seen] for k, x in clues.items()}, ("pushes backwards", "pushes forwards")
    )
    return {
        "at": list(dict.fromkeys(at)), "when": when, "intervals": _moments(p, e), "share": number(share), "of": "force",
    }  # fmt: skip


def _moments(p: Prepared, e: ForceErrors) -> list[list[Any]]:
    """Stretches of time in which most is left: [recording, from, to] in s."""
    b = e.balance
    left = np.nansum(((e.corrected - b.telling) / e.size) ** 2, 1)
    time = np.concatenate([t.time + s.recording.origin for t, s in zip(b.tracks, p.test, strict=True)])
    name = [t.name for t in b.tracks for _ in t.time]
    total = np.bincount(b.block, left)
    out = []
    for k in sorted(np.argsort(-total)[: min(MOMENTS, max(1, total.size // 4))]):
        rows = np.flatnonzero(b.block == k)
        out.append([name[rows[0]], round(float(time[rows[0]]), 4), round(float(time[rows[-1]]), 4)])
    return out


def _location(p: Prepared, train: ForceErrors) -> list[tuple[str, str, float]]:
    """Where the model as given lacks force: (place, kind, ratio to what noise explains), largest first."""
    ratio = train.each_before**2 / np.maximum(train.floors, 1e-9 * train.size) ** 2
    out: dict[tuple[str, str], float] = {}
    for a in map(int, np.flatnonzero(np.isfinite(ratio))):
        key = (p.names.driven_by(p.model, a), "joint" if is_joint_transmission(p.model, a) else "actuator")
        out[key] = max(out.get(key, 0.0), float(ratio[a]))
    return sorted(((n, k, r) for (n, k), r in out.items()), key=lambda row: -row[2])
