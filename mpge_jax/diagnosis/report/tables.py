"""The contents of `diagnosis.json` and of `effects.json`."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mpge_jax.diagnosis import own_effects
from mpge_jax.diagnosis.corrected.mjcf import NOMINAL, corrected_spec
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.intervals import number, parameters
from mpge_jax.diagnosis.estimation.prediction_error import errors
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.report.error_words import error_unit
from mpge_jax.diagnosis.report.sentences import alone, explanation, separation
from mpge_jax.diagnosis.residual.model import ResidualModel
from mpge_jax.diagnosis.verdict.location import locate
from mpge_jax.diagnosis.verdict.part_of_unknown import UNKNOWN
from mpge_jax.diagnosis.verdict.result import Result, before_after_noise, ties_of

Array = np.ndarray


def _effect(d: Result, f: Fitted, term: Term) -> dict[str, Any]:
    return {"id": term.name, "at": term.place.name, "parameters": parameters(d.ctx, f, term)}


def _set(d: Result, f: Fitted) -> list[dict[str, Any]]:
    return [_effect(d, f, t) for t in f.hypothesis.named]


def diagnosis_table(d: Result, experiment: Mapping[str, object] | None = None) -> dict[str, Any]:
    """The contents of `diagnosis.json`. experiment: what `next_experiment.design` found."""

    ties = ties_of(d)
    ambiguous = {t for terms, _ in ties for t in terms}
    effects = []
    for term in d.terms:
        if term in ambiguous and d.verdict == "ambiguous":
            continue
        rivals = [
            {
                "id": r.term.name,
                "at": r.at,
                "held_out": _held_out(d, r.fit),
                "why_not": r.why_not,
            }
            for r in d.rivals.get(term, [])[:5]
        ]
        effects.append(
            {**_effect(d, d.fit, term), "error_drop": number(d.error_drop[term]), "rivals": rivals}
        )
    effects += d.actuators.effects if d.actuators is not None else []
    return {
        "schema": 1,
        "verdict": d.verdict,
        "effects": effects,
        "ambiguous": [
            {
                "candidates": [_set(d, f) for f in fits],
                "separated_by": separation(d, terms, fits),
                "experiment": "next_experiment.npz" if experiment is not None else None,
            }
            for terms, fits in ties
        ]
        + _parts_of_unknown(d, effects),
        "unexplained": None
        if d.unexplained is None
        else {k: x for k, x in d.unexplained.items() if k != "of"},
        "residual": None if d.residual is None else _residual(d.residual),
        "given_inertias": d.given_inertias,
        "location": [{"at": a, "kind": k, "excess": number(e)} for a, k, e in locate(d)],
        "fit": {
            "unit": error_unit(d),
            "window_s": number(_window(d)),
            "train": _fit(d, held=False),
            "held_out": {**_fit(d, held=True), "per_joint": _per_joint(d)},
        },
        "explanation": explanation(d),
        "warnings": d.warnings,
        "seed": d.config.seed,
        "versions": _versions(),
    }


def _parts_of_unknown(d: Result, effects: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """What is named, or that it is a part of what has no name, where the two cannot be told apart."""
    named = {(t.name, t.place.name) for t in d.doubtful}
    parts = [{k: e[k] for k in ("id", "at", "parameters")} for e in effects if (e["id"], e["at"]) in named]
    if not parts or d.unexplained is None:
        return []
    unknown = [{"id": UNKNOWN, "at": at, "parameters": {}} for at in d.unexplained["at"]]
    return [{"candidates": [parts, unknown], "separated_by": alone(d.unexplained["at"]), "experiment": None}]


def _residual(r: ResidualModel) -> dict[str, Any]:
    """What is left as functions: where, of which inputs, in words, over which ranges, and what they do to test data."""
    named = [f"{a.input}:{a.joint or f.term.place.name}" for f in r.functions for a in f.axes]
    ranges = [[number(a.low), number(a.high)] for f in r.functions for a in f.axes]
    said = [f"{f.formula}, at the {f.term.place.name}" for f in r.functions if f.formula is not None]
    return {
        "at": [f.term.place.name for f in r.functions],
        "what": [f.effect.what for f in r.functions],
        "inputs": named,
        "formula": "; ".join(said) if len(said) == len(r.functions) else None,
        "range": dict(zip(named, ranges, strict=True)),
        "held_out": {"before": number(r.before), "after": number(r.after)},
    }


def _window(d: Result) -> float:
    """Length of the windows of the errors, on whose end rows seldom fall; of forces, from row to row."""
    if isinstance(d.held, ForceErrors):
        return d.ctx.period
    longest = float(d.held.windows.times.max())
    return d.config.report_s if abs(longest - d.config.report_s) < 0.05 * d.config.report_s else longest


def _held_out(d: Result, f: Fitted) -> float | None:
    """Held-out error of another fit, of which only the search decided the parameters."""
    if isinstance(d.held, ForceErrors):
        return number(d.held.of(f))
    return number(errors(d.prepared.sim, f, d.held.windows, d.prepared.noise, near=d.fit).rms)


def _fit(d: Result, held: bool) -> dict[str, Any]:
    sources = d.prepared.test if held else d.prepared.looked_at
    before, after, noise = before_after_noise(d.held if held else d.train)
    return {
        "recordings": [s.recording.name for s in sources],
        "before": number(before),
        "after": number(after),
        "noise_floor": number(noise),
    }


def _per_joint(d: Result) -> dict[str, list[float | None]]:
    """Held-out errors (before, after) by joint; where forces are predicted, by the joint that each actuator drives."""
    m, names = d.prepared.model, d.prepared.names
    out: dict[str, list[float | None]] = {}
    r = d.held
    if isinstance(r, ForceErrors):
        before, after = r.each_before, r.each_after
        for a in map(int, np.flatnonzero(d.prepared.measured)):
            name = names.driven_by(m, a)
            key = name if name not in out else f"{name}:{names.actuators[a]}"
            out[key] = [number(before[a]), number(after[a])]
        return out
    for dof in range(m.nv):
        if np.isnan(r.before.joint[dof]):
            continue
        name = names.joint_of_dof(m, dof)
        key = name if name not in out else f"{name}:{dof}"
        out[key] = [number(r.before.joint[dof]), number(r.after.joint[dof])]
    return out


def _versions() -> dict[str, str]:
    from importlib.metadata import PackageNotFoundError, version

    out = {"python": platform.python_version()}
    for package in ("mpge_jax", "mujoco", "numpy", "scipy", "jax"):
        try:
            out[package] = version(package)
        except PackageNotFoundError:
            out[package] = _source_version() if package == "mpge_jax" else "unknown"
    return out


def _source_version() -> str:
    """The version that `pyproject.toml` states, for a checkout that runs without being installed."""
    import tomllib

    try:
        text = (Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8")
        return str(tomllib.loads(text)["project"]["version"])
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        return "unknown"


def effects_table(d: Result) -> dict[str, Any]:
    """The contents of `effects.json`: the nominal model, and every effect to add to it, native or not."""

    _, native = corrected_spec(d)
    rows = []
    h = d.fit.hypothesis
    for term, part in zip(h.terms, h.slices(d.ctx), strict=True):
        values = term.effect.report(d.ctx, term.place, d.fit.theta[part])
        rows.append(
            {
                "id": term.name,
                "form": term.id,
                "at": term.place.name,
                "kind": term.place.kind,
                "parameters": {k: _exact(v) for k, v in values.items()},
                "native": native[term],
            }
        )
        if (file := own_effects.file_of(term.id)) is not None:
            rows[-1]["file"] = str(file)
    for f in () if d.residual is None else d.residual.functions:
        rows.append(
            {
                "id": f.term.name,
                "form": f.term.id,
                "at": f.term.place.name,
                "kind": f.term.place.kind,
                "parameters": {"values": _exact(f.theta)},
                "native": False,
            }
        )
    if d.actuators is not None:
        has = {(t.id, t.place.name): ok for t, ok in native.items()}
        rows += [{**row, "native": has[row["form"], row["at"]]} for row in d.actuators.table]
    # the nominal model: `corrected.xml` holds the native effects already
    return {"schema": 1, "model": NOMINAL, "effects": rows}


def _exact(value: Any) -> Any:
    value = np.asarray(value, dtype=float)
    return float(value) if value.ndim == 0 else [float(v) for v in value]
