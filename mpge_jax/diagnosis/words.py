"""Sentences for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.fitted import Fitted
from mpge_jax.diagnosis.force_errors import force_errors, motion_is_given
from mpge_jax.diagnosis.hypothesis import Term
from mpge_jax.diagnosis.model import is_joint_transmission

if TYPE_CHECKING:
    from mpge_jax.diagnosis.diagnosis import Diagnosis


UNKNOWN = 4.0
"""Width of a component's interval, over the largest component, from which on nothing is known of it."""


SPOKEN = {"command": "units of its command", "command s/rad": "units of its command per rad/s"}
"""Units in words, where they are no unit by themselves."""


def quantity(entry: dict[str, Any]) -> str:
    """'0.70 N m' or '(0.1, 0, 0.2) m' from a parameter entry."""
    value, unit = entry["value"], entry["unit"]
    low, high = np.atleast_1d(entry["low"]).astype(float), np.atleast_1d(entry["high"]).astype(float)
    width = np.nan_to_num(high - low)
    values = np.atleast_1d(value).astype(float)
    shown_at_all = width <= UNKNOWN * np.nanmax(np.abs(values), initial=0.0)
    # a component far below the largest, or below a hundredth of its interval, is nothing
    least = np.maximum(0.01 * width, 1e-4 * np.nanmax(np.abs(values), initial=0.0) * (values.size > 1))
    values = np.where(np.abs(values) < least, 0.0, values)
    shown = [digits(v, w) for v, w in zip(values, width, strict=True)]
    if values.size > 1 and shown_at_all.any():
        shown = [text if known else "unknown" for text, known in zip(shown, shown_at_all, strict=True)]
    text = shown[0] if not isinstance(value, list) else f"({', '.join(shown)})"
    return text if unit == "1" else f"{text} {SPOKEN.get(unit, unit)}"


def digits(value: float, width: float) -> str:
    """A number up to the first digit in which half its interval of a `width` lies, with two to four digits."""
    if not np.isfinite(value):
        return "unknown"
    if value == 0:
        return "0"
    size = np.floor(np.log10(abs(value)))
    fine = np.floor(np.log10(0.5 * width)) if width > 0 else size - 3
    digits = int(np.clip(size - fine + 1, 2, 4))
    text = f"{value:.{digits}g}"
    return f"{float(text):.{max(0, int(digits - 1 - size))}f}" if -5 < size < 6 else text


def intervals(entry: dict[str, Any]) -> str:
    """'0.68 to 0.72 N m' from a parameter entry, component by component."""
    low, high = (x if isinstance(x, list) else [x] for x in (entry["low"], entry["high"]))
    known = [(a, b) for a, b in zip(low, high, strict=True) if a is not None and b is not None]
    text = "; ".join(f"{digits(a, b - a)} to {digits(b, b - a)}" for a, b in known)
    unit = "" if entry["unit"] == "1" else SPOKEN.get(entry["unit"], entry["unit"])
    return f"{text} {unit}".rstrip() if text else "not determined"


def _said(d: Diagnosis, f: Fitted, term: Term) -> str:
    """What an effect's sentence says; it may begin with the name of a place."""
    from mpge_jax.diagnosis.parameters import parameters

    values = {k: quantity(v) for k, v in parameters(d.ctx, f, term).items()}
    return term.effect.sentence(term.place, values)


def clause(text: str) -> str:
    """A sentence as a part of another."""
    text = text.removesuffix(".")
    return text[0].lower() + text[1:] if text.startswith(("The ", "A ")) else text


def _listed(names: list[str]) -> str:
    """'a, b and c'."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def explanation(d: Diagnosis) -> str:
    """What a technician needs to know, in a few sentences."""
    from mpge_jax.diagnosis.parameters import candidates_of

    parts: list[str] = []
    ambiguous = candidates_of(d)
    for term in d.terms:
        if term in ambiguous:
            options = [clause(_said(d, f, _differing(d, f, term))) for f in ambiguous[term]]
            parts.append(f"The recordings cannot tell which: {', or '.join(options)}.")
        else:
            text = _said(d, d.fit, term)
            parts.append(text[0].upper() + text[1:])
    if d.actuators is not None:
        parts += d.actuators.sentences
    if d.unexplained is not None:
        where = _listed(d.unexplained["at"]) or "machine"
        known = "Beyond that, something" if parts else "Something"
        parts.append(
            f"{known} acts at the {where} that no known effect explains: {d.unexplained['when']}. It makes up "
            f"{100 * d.unexplained['share']:.0f} % of the squared error of the {d.unexplained['of']} that the model as "
            "given predicts."
        )
    if not parts:
        parts.append(
            "Nothing is missing: the model predicts the recordings as well as the measurement noise allows."
        )
    if d.terms or (d.actuators is not None and d.actuators.fits):
        parts.append(_gain(d))
    return " ".join(parts)


def _gain(d: Diagnosis) -> str:
    """How much better held-out recordings are predicted."""
    unit = error_unit(d)
    if motion_is_given(d):
        e = force_errors(d, held=True)
        what, before, after, noise = "actuator force that the motion needs", e.before, e.after, e.floor
    else:
        what = f"motion over {d.held.windows.times.max():.2g} s"
        before, after, noise = d.held.before.rms, d.held.after.rms, d.held.floor
    return (
        f"On recordings that were not used for fitting, the error of the predicted {what} falls from {before:.3g} to "
        f"{after:.3g} {unit} ({times(before, after)} less; {beside_noise(after, noise, unit)})."
    )


def times(before: float, after: float) -> str:
    """By how much an error became smaller: '12 times'."""
    ratio = before / max(after, 1e-300)
    return "more than 1000 times" if ratio > 1000 else f"{ratio:.3g} times"


def beside_noise(after: float, noise: float, unit: str) -> str:
    """What noise alone does, beside what is left: its estimate is not trusted beyond that (`FitReport.above`)."""
    if noise >= 0.999 * after:
        return "that is no more than measurement noise leaves"
    return f"noise alone gives {noise:.2g} {unit}"


def error_unit(d: Diagnosis) -> str:
    """Unit of the errors: of positions over all joints together or, where the motion is given, of forces."""
    m = d.prepared.model
    measured = [
        not all(np.isnan(s.recording.qpos[:, q]).all() for s in d.prepared.train_sources)
        for q in m.jnt_qposadr
    ]
    kinds = set(m.jnt_type[measured].tolist())
    if motion_is_given(d):
        driven = [a for a in map(int, np.flatnonzero(d.prepared.measured)) if is_joint_transmission(m, a)]
        kinds = {int(m.jnt_type[m.actuator_trnid[a, 0]]) for a in driven}
        hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
        return "N and N m" if len(kinds) > 1 else ("N m" if kinds == {hinge} else "N")
    if kinds <= {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_BALL)}:
        return "rad"
    return "m" if kinds == {int(mujoco.mjtJoint.mjJNT_SLIDE)} else "rad and m"


def unit_of_joint(d: Diagnosis, name: str) -> str:
    """Unit of one joint's errors, or of the force of what drives it; `name` as in the table of joints."""
    m, names = d.prepared.model, d.prepared.names
    joint = name if name in names.joints else name.partition(":")[0]
    if joint not in names.joints:
        return error_unit(d)
    j, dof = names.joints.index(joint), name.removeprefix(joint).removeprefix(":")
    linear = m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
    if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
        linear = not dof.isdecimal() or int(dof) - int(m.jnt_dofadr[j]) < 3
    if motion_is_given(d):
        return "N" if linear else "N m"
    return "m" if linear else "rad"


def _differing(d: Diagnosis, f: Fitted, term: Term) -> Term:
    if term in f.hypothesis.terms:
        return term
    return next(t for t in f.hypothesis.terms if t not in d.terms)


def separation(d: Diagnosis, term: Term, fits: list[Fitted]) -> str:
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
