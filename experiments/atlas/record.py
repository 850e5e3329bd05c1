"""One machine: diagnosed, and what the atlas keeps of it."""

import json
import os
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from experiments.atlas.machines import Machine
from experiments.storage import versions
from mpge_jax import files
from mpge_jax.diagnosis import Config, Diagnosis, diagnose
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.report.markdown_page import markdown
from mpge_jax.diagnosis.report.tables import diagnosis_table

Array = np.ndarray
FOLDER = "MPGE_RECORDINGS"
"""Environment variable that names the folder of the machines' recordings."""
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def folder_given() -> Path | None:
    """The folder of the machines' recordings that the environment names."""
    named = os.environ.get(FOLDER)
    return None if named is None else Path(named)


def diagnosed(machine: Machine, recordings: Path, jobs: int, progress: Path | None = None) -> Diagnosis:
    """The diagnosis of a machine whose folder lies below `recordings`. `progress` as in `diagnose`."""
    folder = recordings / machine.folder
    return diagnose(folder / "model.xml", folder, Config(jobs=jobs), None, progress)


def kept(docs: Path, key: str) -> Path:
    """Where the row of a machine is kept."""
    return docs / "results" / "atlas" / f"{key}.json"


def keep(d: Diagnosis, machine: Machine, recordings: Path, docs: Path) -> None:
    """Writes the machine's page, its picture, and its row of the atlas (last, as it says that all is there)."""
    given = f"--model {machine.folder}/model.xml --recordings {machine.folder}"
    command = f"python -m experiments.diagnose {given} --out out"
    files.write_text(docs / "machines" / f"{machine.key}.md", markdown(d, machine.title, command))
    row = facts(d) | source(recordings / Path(machine.folder).parts[0] / "README.txt")
    files.write_text(kept(docs, machine.key), json.dumps(row, indent=1) + "\n")


def facts(d: Diagnosis) -> dict[str, Any]:
    """What the atlas says of a diagnosis; errors of held-out recordings, before and after, in one order of joints."""
    table = diagnosis_table(d)
    held = table["fit"]["held_out"]
    force = isinstance(d.held, ForceErrors)
    names, before, after = _of_forces(d.held) if isinstance(d.held, ForceErrors) else _of_windows(d, d.held)
    medians = (
        None
        if isinstance(d.held, ForceErrors)
        else [_number(np.median(x.window)) for x in (d.held.before, d.held.after)]
    )
    return {
        "verdict": table["verdict"],
        "effects": [[row["id"], row["at"]] for row in table["effects"]],
        "ambiguous": [
            [[[row["id"], row["at"]] for row in rows] for rows in one["candidates"]]
            for one in table["ambiguous"]
        ],
        "left_at": [] if table["unexplained"] is None else list(table["unexplained"]["at"]),
        "measure": "force" if force else "motion",
        "unit": table["fit"]["unit"],
        "window_s": table["fit"]["window_s"],
        "before": held["before"],
        "after": held["after"],
        "median_window": medians,
        "noise": held["noise_floor"],
        "with_residual": None if table["residual"] is None else table["residual"]["held_out"]["after"],
        "each": {name: [_number(b), _number(a)] for name, b, a in zip(names, before, after, strict=True)},
        "seconds": round(d.seconds),
        "jobs": d.config.jobs,
        "load_average": round(os.getloadavg()[0], 1),
        "versions": versions(),
    }


def source(readme: Path) -> dict[str, str]:
    """Where recordings come from and under which licence, in short, from their README."""
    text = readme.read_text("utf-8")
    said = {}
    for name, pattern in (
        ("source", r"Source repo\s*: *([^,(;\n]+)"),
        ("licence", r"License\s*: *([^(\n]+)"),
    ):
        found = re.search(pattern, text)
        if found is None:
            raise ValueError(f"{readme} has no line that says its {name}")
        said[name] = found[1].strip()
    return said


def _of_forces(held: ForceErrors) -> tuple[list[str], Array, Array]:
    """Errors over the forces, of every measured actuator."""
    seen = np.flatnonzero(np.isfinite(held.each_before))
    names = [held.balance.ctx.names.actuators[a] for a in map(int, seen)]
    return names, (held.each_before / held.size)[seen], (held.each_after / held.size)[seen]


def _of_windows(d: Diagnosis, held: FitReport) -> tuple[list[str], Array, Array]:
    """Medians over windows of the rms error: of every joint, of a free body's position and of its rotation."""
    m, names = d.prepared.model, d.prepared.names
    groups: dict[str, list[int]] = {}
    for dof in map(int, np.flatnonzero(np.isfinite(held.before.joint))):
        joint = m.dof_jntid[dof]
        name = names.joint_of_dof(m, dof)
        if m.jnt_type[joint] == _FREE:
            name = f"{name}, {'position' if dof - m.jnt_dofadr[joint] < 3 else 'rotation'}"
        groups.setdefault(name, []).append(dof)
    sides = []
    for errors in (held.before, held.after):
        squares = [np.sum(errors.curves[:, :, dofs] ** 2, axis=2) for dofs in groups.values()]
        sides.append(np.array([np.median(_rms_of_windows(square)) for square in squares]))
    return list(groups), sides[0], sides[1]


def _rms_of_windows(square: Array) -> Array:
    """[W, N] squares, NaN where not measured, to the rms of every window that was measured."""
    measured = square[np.isfinite(square).any(axis=1)]
    return np.sqrt(np.nanmean(measured, axis=1))


def _number(x: Any) -> float:
    return float(f"{x:.4g}")
