"""A fleet of two pendulums with more damping than their model, for tests that diagnose it in earnest."""

from pathlib import Path

import numpy as np

from tests.diagnosis.machines import PENDULUM, record

COEFFICIENTS = {"left": 0.05, "right": 0.1}
TIMES = ("cost.json",)
"""What a diagnosis took, in which runs differ."""


def make(folder: Path) -> list[str]:
    """Writes model and recordings; returns the options of the command that diagnoses them."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(PENDULUM)
    for name, more in COEFFICIENTS.items():

        def damped(model, more=more):
            model.dof_damping[0] += more

        (folder / "robots" / name).mkdir(parents=True)
        for r in record(PENDULUM, 1.2, change=damped, count=2, seconds=1.0):
            np.savez(folder / "robots" / name / f"{r.name}.npz", time=r.time, qpos=r.qpos, ctrl=r.ctrl)
    return options(folder)


def options(folder: Path) -> list[str]:
    """Of the command that diagnoses the fleet in a folder."""
    given = ["--model", str(folder / "model.xml"), "--robots", str(folder / "robots")]
    return [*given, "--effects", "viscous_damping", "armature"]


def results_of(out: Path) -> dict[str, bytes]:
    """Everything that the command left, but how long it took and what a scheduler wrote."""
    found = {p.relative_to(out): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}
    return {str(k): x for k, x in found.items() if k.name not in TIMES and k.parts[0] != "jobs"}
