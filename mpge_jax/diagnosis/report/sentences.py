"""Sentences for people."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.intervals import parameters
from mpge_jax.diagnosis.estimation.quantities import clause, intervals, quantity
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.machine.model import is_joint_transmission
from mpge_jax.diagnosis.residual.model import Function, ResidualModel
from mpge_jax.diagnosis.verdict.result import Result, before_after_noise, candidates_of

SEVERAL = 3
"""Places from which on one effect is told for all of them in a sentence."""
OVERESTIMATED = 1.5
"""How many times what is left the noise's estimate may be for that to pass as noise. Errors of windows scatter; beyond
that something else, such as a rough command, was taken for noise."""

PLAINLY = 2.0
"""Times the noise from which on it is said how far an error is beyond it."""


def _said(d: Result, f: Fitted, term: Term) -> str:
    """What an effect's sentence says; it may begin with the name of a place."""

    values = {k: quantity(v) for k, v in parameters(d.ctx, f, term).items()}
    return term.effect.sentence(term.place, values)


def _listed(names: list[str]) -> str:
    """'a, b and c'."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _alike(terms: list[Term], d: Result) -> dict[Term, list[Term]]:
    """Effects of one parameter that act at several places, each with all of its kind."""
    kinds: dict[str, list[Term]] = {}
    for t in terms:
        if len(t.params(d.ctx)) == 1:
            kinds.setdefault(t.id, []).append(t)
    return {t: kind for kind in kinds.values() if len(kind) >= SEVERAL for t in kind}


def _said_together(d: Result, terms: list[Term]) -> str:
    """'Viscous damping that the model lacks: 16 N m s/rad at shoulder and 2.1 N m s/rad at elbow.'"""
    values = [(quantity(v), t.place.name) for t in terms for v in parameters(d.ctx, d.fit, t).values()]
    what = terms[0].name.replace("_", " ")
    return (
        f"{what[0].upper() + what[1:]} that the model lacks: {_listed([f'{v} at {at}' for v, at in values])}."
    )


def _of_effects(d: Result) -> Iterator[tuple[float, str]]:
    """A sentence for every effect, or for several that are alike, with the largest share of the error that goes with
    one of them."""
    ambiguous = candidates_of(d)
    alike = _alike([t for t in d.terms if t not in ambiguous], d)
    for term in d.terms:
        if term in ambiguous:
            options = [clause(_said(d, f, _differing(d, f, term))) for f in ambiguous[term]]
            yield _share(d, [term]), f"The recordings cannot tell which: {', or '.join(options)}."
        elif term not in alike:
            text = _said(d, d.fit, term)
            yield _share(d, [term]), text[0].upper() + text[1:]
        elif term is alike[term][0]:
            yield _share(d, alike[term]), _said_together(d, alike[term])


def _of_inertias(d: Result) -> list[str]:
    """What is said of the given masses and inertias where they are off, with the one that is off most."""
    changes = [
        (abs(body[what]["value"] - 1.0), f"{body[what]['value']:.3g} times the {what} of {body['at']}")
        for what in ("mass", "inertia")
        for body in d.given_inertias or []
    ]
    if not changes:
        return []
    return [
        "The given masses and inertias are not exact, which is usual and no missing physics; corrected.xml has better "
        f"ones (what changes most: {max(changes)[1]})."
    ]


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
            said += (
                f" It makes up {100 * d.unexplained['share']:.0f} % of the squared error of the "
                f"{d.unexplained['of']} that the model as given predicts."
            )
        parts.append(said)
    if d.residual is not None:
        parts.append(_residual(d.residual, error_unit(d)))
    if not parts:
        parts.append(
            "Nothing is missing: the model predicts the recordings as well as their noise and its timestep allow."
        )
    if d.fit.hypothesis.terms or (d.actuators is not None and d.actuators.fits):
        parts.append(_gain(d))
    if d.remainder > 0:
        parts.append(
            f"A remainder of {100 * d.remainder:.2g} % of the squared error is more than noise"
            f"{_beyond_noise(d)}; it is too slight to change what is named."
        )
    return " ".join(parts)


def _beyond_noise(d: Result) -> str:
    """How far the held-out error is beyond noise; nothing where that is not far."""
    _, after, noise = before_after_noise(d.held)
    return f" (the error is {times(noise, after)} what noise alone leaves)" if after > PLAINLY * noise else ""


def _residual(r: ResidualModel, unit: str) -> str:
    """What is left as functions, and what they do to recordings that they never saw."""
    each = [f"at the {f.term.place.name}, {of_inputs(f)}" for f in r.functions]
    return (
        f"It is modelled all the same, as a smooth function {'; '.join(each)}: with it the error of held-out "
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


def _gain(d: Result) -> str:
    """How much better held-out recordings are predicted."""
    unit = error_unit(d)
    before, after, noise = before_after_noise(d.held)
    if isinstance(d.held, ForceErrors):
        what = "actuator force that the motion needs"
    else:
        what = f"motion over {d.held.windows.times.max():.2g} s"
    return (
        f"On recordings that were not used for fitting, the error of the predicted {what} {moves(before, after, unit)} "
        f"({beside_noise(after, noise, unit, not isinstance(d.held, ForceErrors))})."
    )


def moves(before: float, after: float, unit: str) -> str:
    """How an error changes: 'falls from 12 to 1 rad, 12 times smaller', or that it rises or stays."""
    if f"{before:.3g}" == f"{after:.3g}":
        return f"stays at {after:.3g} {unit}"
    verb, way = ("falls", "smaller") if after < before else ("rises", "larger")
    return f"{verb} from {before:.3g} to {after:.3g} {unit}, {times(before, after)} {way}"


def times(before: float, after: float) -> str:
    """By how much an error became smaller or larger: '12 times'."""
    ratio = max(before, after) / max(min(before, after), 1e-300)
    return "more than 1000 times" if ratio > 1000 else f"{ratio:.3g} times"


def worse_without(drop: float) -> str:
    """How much larger the error is without an effect, the others kept, from the share of the squared error that goes
    with it (`error_drops`): '3.2 times'."""
    if drop < 0:
        return "smaller"
    said = times(1.0, float(np.sqrt(max(1.0 - drop, 0.0))))
    return "hardly larger" if said == "1 times" else said


def effect_rows(table: dict[str, Any]) -> list[list[str]]:
    """A row for every parameter of every effect in `diagnosis.json`: effect, place, parameter, value, 95 % interval,
    and how much larger the held-out error is without the effect; the effect without which it is largest comes first."""
    rows = []
    for e in sorted(table["effects"], key=lambda e: -(e.get("error_drop") or 0.0)):
        without = "" if e.get("error_drop") is None else worse_without(e["error_drop"])
        for name, p in (e["parameters"] or {"": None}).items():
            rows.append([e["id"], e["at"], name, *((quantity(p), intervals(p)) if p else ("", "")), without])
    return rows


def beside_noise(after: float, noise: float, unit: str, moves: bool = True) -> str:
    """What is no missing physics does, beside what is left.

    Args:
        moves: whether a motion is predicted; forces along a given one hang on no timestep.
    """
    if noise < 0.999 * after:
        return f"{no_physics(moves)} {noise:.2g} {unit}"
    if noise <= OVERESTIMATED * after:
        return "that is no more than measurement noise leaves"
    return (
        f"how much of that is noise is unknown, as its estimate is too high: it would give {noise:.2g} {unit}"
    )


def no_physics(moves: bool) -> str:
    """What leaves errors though nothing is missing, of predicted motions or of forces."""
    return "noise and timestep alone give" if moves else "noise alone gives"


def error_unit(d: Result) -> str:
    """Unit of the errors: of positions over all joints together or, where the motion is given, of forces."""
    m = d.prepared.model
    measured = [
        not all(np.isnan(s.recording.qpos[:, q]).all() for s in d.prepared.train) for q in m.jnt_qposadr
    ]
    kinds = set(m.jnt_type[measured].tolist())
    if isinstance(d.held, ForceErrors):
        driven = [a for a in map(int, np.flatnonzero(d.prepared.measured)) if is_joint_transmission(m, a)]
        kinds = {int(m.jnt_type[m.actuator_trnid[a, 0]]) for a in driven}
        hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
        return "N and N m" if len(kinds) > 1 else ("N m" if kinds == {hinge} else "N")
    if kinds <= {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_BALL)}:
        return "rad"
    return "m" if kinds == {int(mujoco.mjtJoint.mjJNT_SLIDE)} else "rad and m"


def unit_of_motion(model: mujoco.MjModel, dof: int) -> str:
    """Unit of the position of one degree of freedom."""
    kind, first = model.jnt_type[model.dof_jntid[dof]], int(model.jnt_dofadr[model.dof_jntid[dof]])
    free = kind == mujoco.mjtJoint.mjJNT_FREE and dof - first < 3
    return "m" if free or kind == mujoco.mjtJoint.mjJNT_SLIDE else "rad"


def unit_of_joint(d: Result, name: str) -> str:
    """Unit of one joint's errors, or of the force of what drives it; `name` as in the table of joints."""
    m, names = d.prepared.model, d.prepared.names
    joint = name if name in names.joints else name.partition(":")[0]
    if joint not in names.joints:
        return error_unit(d)
    dofs, number = np.flatnonzero(m.dof_jntid == names.joints.index(joint)), name.removeprefix(f"{joint}:")
    unit = unit_of_motion(m, int(next((dof for dof in dofs if str(dof) == number), dofs[0])))
    return {"m": "N", "rad": "N m"}[unit] if isinstance(d.held, ForceErrors) else unit


def _differing(d: Result, f: Fitted, term: Term) -> Term:
    if term in f.hypothesis.terms:
        return term
    return next(t for t in f.hypothesis.named if t not in d.terms)


def separation(d: Result, term: Term, fits: list[Fitted]) -> str:
    """The experiment that would tell the candidates apart."""
    others = [_differing(d, f, term) for f in fits]
    places = list(dict.fromkeys(t.place.name for t in others))
    movable = all(t.place.kind in ("joint", "actuator", "body") for t in others)
    if movable and len(places) > 1 and len({t.name for t in others}) == 1:
        return f"move {' and '.join(places)} one at a time"
    remedies = [t.effect.remedy for t in others]
    unique = list(dict.fromkeys(r for r in remedies if r))
    # one that says more says the other too
    unique = [r for r in unique if not any(r != more and r in more for more in unique)]
    return "; ".join(unique)[:600] or "move every joint over its whole range at several speeds"
