"""The corrections for the user's own files: `corrected.yaml`, `corrected.patch`, and `corrected.urdf`."""

from __future__ import annotations

import difflib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

import mujoco
import yaml

from mpge_jax import files
from mpge_jax.diagnosis.corrected import own_mjcf, own_urdf
from mpge_jax.diagnosis.corrected.differences import Change, differences, table
from mpge_jax.diagnosis.corrected.mjcf import NOMINAL, corrected_spec
from mpge_jax.diagnosis.corrected.xml_edits import XmlText
from mpge_jax.diagnosis.machine.model import load_spec
from mpge_jax.diagnosis.verdict.result import Result

YAML, PATCH, URDF = "corrected.yaml", "corrected.patch", "corrected.urdf"
_DIGITS = 1e-6
"""How far a number may be off that was written in nine digits and went through the compiler."""


@dataclass(frozen=True)
class Patched:
    """The user's own file with corrections. text: None where it could not be patched. lacking: what it cannot say,
    sentence by sentence."""

    language: str
    text: str | None
    lacking: list[str]


def write_patch(d: Result, folder: Path) -> None:
    """Write the corrected parameters as YAML, and the user's own file with them as a patch (a URDF also whole)."""
    nominal = d.prepared.spec.copy().compile()
    spec, native = corrected_spec(d)
    corrected = spec.compile()
    changes = differences(nominal, corrected)
    content: dict[str, Any] = {"model": NOMINAL if d.model is None else d.model.name, **table(changes)}
    elsewhere = [f"{t.name} at {t.place.name}" for t, ok in native.items() if not ok]
    if elsewhere:
        content["only_in_effects_json"] = elsewhere
    for name in (PATCH, URDF):
        (folder / name).unlink(missing_ok=True)
    if d.model is not None and changes:
        own = patched(d.model, nominal, corrected, changes)
        lacking = own.lacking + [f"{what}: MuJoCo has no element for it." for what in elsewhere]
        if lacking:
            content[f"not_in_{own.language.lower()}"] = lacking
        if own.text is not None:
            before, after = (
                io.StringIO(text, newline="\n").readlines()
                for text in (d.model.read_bytes().decode(), own.text)
            )
            diff = difflib.unified_diff(before, after, d.model.name, d.model.name)
            files.write_text(folder / PATCH, "".join(map(_ended, diff)))
            if own.language == "URDF":
                files.write_text(folder / URDF, _with_note(own.text, d.model.name, lacking))
    header = (
        "# Parameters that the recordings correct, by kind and name of the element, in SI units.\n"
        f"# {PATCH} puts them into {content['model']}, where that was given as a file.\n"
    )
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
    files.write_text(folder / YAML, header + text)


def patched(path: Path, nominal: mujoco.MjModel, corrected: mujoco.MjModel, changes: list[Change]) -> Patched:
    """The user's MJCF or URDF with changes, compiled again: what it does not have then is what it lacks."""
    language = "URDF" if path.suffix == ".urdf" else "MJCF"
    try:
        text = XmlText(path.read_bytes())
        language = "URDF" if text.root.tag == "robot" else "MJCF"
        if any(text.root.iter("include", "attach", "replicate", "composite", "flexcomp")):
            why = "is made of other files or of copies, which only corrected.xml holds corrected"
            return Patched(language, None, [f"{path.name} {why}."])
        if language == "URDF":
            own_urdf.edit(text, nominal, corrected, changes)
        else:
            own_mjcf.edit(text, corrected, changes)
        edited = text.result().decode()
        left = differences(load_spec(path, text.result()).compile(), corrected, _DIGITS)
    except (OSError, ExpatError, ValueError, IndexError, mujoco.FatalError) as error:
        why = " ".join(str(error).split())
        return Patched(language, None, [f"{path.name} could not be edited ({why}); take corrected.xml."])
    sentences = [f"{c}: {_why(c, language)}" for c in left]
    return Patched(language, None if text.result() == text.text else edited, sentences)


def _why(change: Change, language: str) -> str:
    known = {"damping", "frictionloss", "mass", "com", "inertia"}
    if language == "URDF" and change.quantity.name not in known:
        return "URDF has no element for it."
    return f"{language} has no place for the value there; take corrected.xml."


def _ended(line: str) -> str:
    return line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n"


def _with_note(text: str, name: str, lacking: list[str]) -> str:
    said = f"{name} with corrected parameters; it belongs into the folder of {name}."
    note = " ".join([said, *(["Not in it:"] if lacking else []), *lacking]).replace("--", "- -")
    at = XmlText(text.encode()).root.start
    raw = text.encode()
    return (raw[:at] + f"<!-- {note} -->\n".encode() + raw[at:]).decode()
