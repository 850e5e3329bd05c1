"""The corrected model as MJCF: native elements wherever MuJoCo has one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco

from mpge_jax.diagnosis.hypothesis import Term

if TYPE_CHECKING:
    from mpge_jax.diagnosis.diagnosis import Diagnosis


def corrected_spec(d: Diagnosis) -> tuple[mujoco.MjSpec, dict[Term, bool]]:
    """(nominal spec with the effects added, which effects have a native form)."""
    spec = d.prepared.spec.copy()
    spec.compile()  # gives elements their indices
    native: dict[Term, bool] = {}
    parts = d.fit.hypothesis.split(d.ctx, d.fit.theta)
    for term, theta in parts.items():
        native[term] = term.effect.export(spec, d.ctx, term.place, theta)
    if d.actuators is not None:
        d.actuators.export(spec)
    return spec, native


def corrected_xml(d: Diagnosis) -> str:
    """MJCF text of the corrected model, with a comment that names what `effects.json` holds beside it."""
    spec, native = corrected_spec(d)
    spec.compile()
    text = spec.to_xml()
    missing = [f"{t.name} at {t.place.name}" for t, ok in native.items() if not ok]
    if missing:
        listed = "; ".join(missing).replace("--", "- -")
        text = text.replace(">", f">\n  <!-- MuJoCo has no element for: {listed}. See effects.json. -->", 1)
    return text
