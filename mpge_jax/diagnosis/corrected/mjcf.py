"""The nominal and the corrected model as MJCF, native elements wherever MuJoCo has one, and the files they need."""

from __future__ import annotations

import copy
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco

from mpge_jax import files
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.verdict.result import Result

NOMINAL, CORRECTED, ASSETS = "nominal.xml", "corrected.xml", "assets"


def corrected_spec(d: Result) -> tuple[mujoco.MjSpec, dict[Term, bool]]:
    """(nominal spec with the effects added, which effects have a native form)."""
    spec = d.prepared.spec.copy()
    spec.compile()  # gives elements their indices
    native: dict[Term, bool] = {}
    parts = d.fit.hypothesis.split(d.ctx, d.fit.theta)
    ctx = _as_given(d) if parts else d.ctx
    for term, theta in parts.items():
        native[term] = term.effect.export(spec, ctx, term.place, theta)
    if d.residual is not None:
        native |= {f.term: False for f in d.residual.functions}
    if d.actuators is not None:
        native |= d.actuators.export(spec)
    return spec, native


def _as_given(d: Result) -> Context:
    """The machine with its own timestep: what is written depends on that, not on the step of the fit."""
    model = copy.copy(d.ctx.model)
    model.opt.timestep = d.prepared.timestep
    return replace(d.ctx, model=model)


def write_models(d: Result, folder: Path) -> tuple[str, str]:
    """Write `nominal.xml` (the model as given) and `corrected.xml`; meshes and images go to `assets/`.

    A comment in `corrected.xml` names the effects that only `effects.json` holds. Returns both texts.
    """
    nominal = d.prepared.spec.copy()
    nominal.compile()
    given = _text(nominal, folder)
    spec, native = corrected_spec(d)
    spec.compile()
    missing = [f"{t.name} at {t.place.name}" for t, ok in native.items() if not ok]
    corrected = with_comment(_text(spec, folder), missing)
    files.write_text(folder / NOMINAL, given)
    files.write_text(folder / CORRECTED, corrected)
    return given, corrected


def with_comment(xml: str, missing: list[str]) -> str:
    """A model that says which effects it lacks."""
    # a comment holds no two hyphens in a row
    listed = re.sub("-(?=-)", "- ", "; ".join(missing))
    comment = f"\n  <!-- MuJoCo has no element for: {listed}. See effects.json. -->"
    return xml.replace(">", f">{comment}", 1) if missing else xml


def _text(spec: mujoco.MjSpec, folder: Path) -> str:
    """MJCF of a compiled spec, which is changed to refer to copies of its files in `folder/assets`."""
    taken: dict[str, Path | bytes] = {}

    def take(value: str, directory: str) -> str:
        source = _find(spec, directory, value) if value else None
        if source is None:
            return value
        name = Path(value).name
        while taken.get(name, source) != source:
            name = f"_{name}"
        taken[name] = source
        return name

    for owner, directory in _references(spec):
        owner.file = take(owner.file, directory)
    for texture in spec.textures:
        texture.cubefiles = [take(value, spec.texturedir) for value in texture.cubefiles]
    for name, source in taken.items():
        _copy(source, folder / ASSETS / name)
    if taken:
        spec.modelfiledir = f"{folder.resolve()}{os.sep}"
        spec.meshdir = spec.texturedir = ASSETS
    return spec.to_xml()


def _references(spec: mujoco.MjSpec) -> list[tuple[Any, str]]:
    """(element, folder) of everything that may be read from a `file`."""
    shapes = [(x, spec.meshdir) for x in (*spec.meshes, *spec.hfields, *spec.skins)]
    return shapes + [(x, spec.texturedir) for x in spec.textures]


def _find(spec: mujoco.MjSpec, directory: str, value: str) -> Path | bytes | None:
    """The file behind a reference, or its bytes where the spec carries them."""
    for key in (value, os.path.join(directory, value), Path(value).name):
        if key in spec.assets:
            return bytes(spec.assets[key])
    root = Path(spec.modelfiledir or ".")
    # URDF drops the folders of its references
    for path in (root / directory / value, root / value, root / directory / Path(value).name):
        if path.is_file():
            return path.resolve()
    return None


def _copy(source: Path | bytes, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(target.name + ".partial")
    if isinstance(source, bytes):
        partial.write_bytes(source)
    elif source != target.resolve():
        shutil.copyfile(source, partial)
    else:
        return
    os.replace(partial, target)
