"""Writes a task file for your own robot, which runs at once: `python -m experiments.new my_robot.xml`.

The file has a reset, an observation, a reward and a termination for the robot's kind of base, with remarks on what to
change, and a target with heavier parts to try methods on.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from experiments.ending import exit_status
from mpge_jax import files
from mpge_jax.task_files.robot import Robot, name_of, robot_of
from mpge_jax.task_files.template import text_of


@dataclass(frozen=True)
class Args:
    """Writes a task file for a robot of your own."""

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(help="MJCF file of the robot")]
    out: Annotated[
        Path | None,
        tyro.conf.arg(help="task file to write", help_behavior_hint="(default: MODEL.py beside it)"),
    ] = None
    name: Annotated[
        str | None, tyro.conf.arg(help="of the task", help_behavior_hint="(default: from the model's file)")
    ] = None


def _free(name: str) -> str:
    """A name that no environment has."""
    return f"My{name}" if {name, f"{name}Target"} & set(envs.names()) else name


def write(args: Args) -> tuple[Path, Robot]:
    """Writes the file and tries it; returns where it lies and what it is about.

    Raises:
      ValueError: the model cannot be used, the file exists, or it does not run as it was written.
    """
    out = args.out or args.model.with_suffix(".py")
    if out.suffix != ".py":
        raise ValueError(f"--out {out} must end in .py")
    if out.exists():
        raise ValueError(f"{out} exists already; remove it or give another --out")
    robot = robot_of(args.model, out, args.name or _free(name_of(args.model.stem)))
    files.write_text(out, text_of(robot))
    envs.make(f"{out}:{robot.name}", "c")
    return out, robot


def main() -> int:
    """The command; returns its exit status."""
    return exit_status("new", _new, goes_on=False)


def _new() -> int:
    out, robot = write(tyro.cli(Args, prog="python -m experiments.new", description=Args.__doc__))
    print(f"{out} has the task {robot.name} and the target {robot.name}Target. Look at its reward, then:\n")
    print(f"  python -m experiments.pretrain --task {out}:{robot.name} --kind MS")
    print(f"  python -m experiments.sweep --task {out}:{robot.name}Target --method direct MPGE-MS target")
    return 0


if __name__ == "__main__":
    sys.exit(main())
