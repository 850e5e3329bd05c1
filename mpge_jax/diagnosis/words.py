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


def quantity(entry: dict[str, Any]) -> str:
    """'0.70 N m' or '(0.1, 0, 0.2) m' from a parameter entry."""
    value, unit = entry["value"], entry["unit"]
    low, high = np.atleast_1d(entry["low"]).astype(float), np.atleast_1d(entry["high"]).astype(float)
    width = np.nan_to_num(high - low)
    values = np.atleast_1d(value).astype(float)
    # a component far below the largest, or below a hundredth of its interval, is nothing
    least = np.maximum(0.01 * width, 1e-4 * np.nanmax(np.abs(values), initial=0.0) * (values.size > 1))
    values = np.where(np.abs(values) < least, 0.0, values)
    shown = [digits(v, w) for v, w in zip(values, width, strict=True)]
    text = shown[0] if not isinstance(value, list) else f"({', '.join(shown)})"
    return text if unit == "1" else f"{text} {unit}"


def digits(value: float, width: float) -> str:
    """A number with two digits of its uncertainty, four digits at most."""
    if not np.isfinite(value):
        return "unknown"
    if value == 0:
        return "0"
    size = np.floor(np.log10(abs(value)))
    fine = np.floor(np.log10(width)) if width > 0 else size - 3
    digits = int(np.clip(size - fine + 1, 2, 4))
    text = f"{value:.{digits}g}"
    return f"{float(text):.{max(0, int(digits - 1 - size))}f}" if -5 < size < 6 else text


def sentence(d: Diagnosis, f: Fitted, term: Term) -> str:
    from mpge_jax.diagnosis.parameters import parameters

    values = {k: quantity(v) for k, v in parameters(d.ctx, f, term).items()}
    text = term.effect.sentence(term.place, values)
    return text[0].upper() + text[1:]


def _clause(text: str) -> str:
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
            options = [_clause(sentence(d, f, _differing(d, f, term))) for f in ambiguous[term]]
            parts.append(f"The recordings cannot tell which: {', or '.join(options)}.")
        else:
            parts.append(sentence(d, d.fit, term))
    if d.actuators is not None:
        parts += d.actuators.sentences
    if d.unexplained is not None:
        where = _listed(d.unexplained["at"]) or "machine"
        known = "Beyond that, something" if parts else "Something"
        parts.append(
            f"{known} acts at the {where} that no known effect explains: {d.unexplained['when']}. It makes up "
            f"{100 * d.unexplained['share']:.0f} % of the squared error."
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
        f"{after:.3g} {unit} ({before / max(after, 1e-12):.1f} times less; noise alone gives {noise:.2g} {unit})."
    )


def error_unit(d: Diagnosis) -> str:
    """Unit of the errors: of positions over all joints together or, where the motion is given, of forces."""
    m = d.prepared.model
    kinds = set(m.jnt_type.tolist())
    if motion_is_given(d):
        driven = [a for a in map(int, np.flatnonzero(d.prepared.measured)) if is_joint_transmission(m, a)]
        kinds = {int(m.jnt_type[m.actuator_trnid[a, 0]]) for a in driven}
        hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
        return "N and N m" if len(kinds) > 1 else ("N m" if kinds == {hinge} else "N")
    if kinds <= {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_BALL)}:
        return "rad"
    return "m" if kinds == {int(mujoco.mjtJoint.mjJNT_SLIDE)} else "rad and m"


def _differing(d: Diagnosis, f: Fitted, term: Term) -> Term:
    if term in f.hypothesis.terms:
        return term
    return next(t for t in f.hypothesis.terms if t not in d.terms)


def separation(d: Diagnosis, term: Term, fits: list[Fitted]) -> str:
    """The experiment that would tell the candidates apart."""
    remedies = []
    for f in fits:
        other = _differing(d, f, term)
        remedies.append(other.effect.remedy)
    unique = list(dict.fromkeys(r for r in remedies if r))
    return "; ".join(unique)[:600] or "move every joint over its whole range at several speeds"
