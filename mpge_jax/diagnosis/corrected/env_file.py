"""The corrected machine as an environment in a file, for this library, MuJoCo Playground and brax."""

from __future__ import annotations

from pathlib import Path

from mpge_jax import files
from mpge_jax.diagnosis.corrected.mjcf import NOMINAL
from mpge_jax.diagnosis.verdict.result import Result
from mpge_jax.task_files.robot import name_of, robot_of
from mpge_jax.task_files.template import corrected_text_of

ENV = "corrected_env.py"


def write_env(d: Result, folder: Path) -> None:
    """Write `corrected_env.py` beside `nominal.xml` and `effects.json`, from which it builds the machine.

    A machine on which no policy can act has none: one without actuators, or whose commands have no positive end.
    """
    path = folder / ENV
    path.unlink(missing_ok=True)
    stem = "machine" if d.model is None else d.model.stem
    try:
        robot = robot_of(folder / NOMINAL, path, f"Corrected{name_of(stem)}")
    except ValueError:
        return
    files.write_text(path, corrected_text_of(robot))
