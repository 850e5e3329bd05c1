"""Where jobs run, and what each may use: the options that every command with jobs has."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

ARRAY = 1000
"""Jobs of one array of Slurm at most: its MaxArraySize is 1001 where nobody set it."""

AHEAD = 1000
"""Jobs that Ray is given at a time: enough for its scheduler and autoscaler, and a short list to wait on."""


@dataclass(frozen=True)
class Options:
    """Where jobs run.

    Raises:
      ValueError: a number out of range, or an option of sbatch that is not NAME=VALUE.
    """

    runner: Annotated[
        Literal["local", "ray", "slurm"],
        tyro.conf.arg(help="this machine, a Ray cluster, or Slurm; of the last two all machines share --out"),
    ] = "local"
    workers: Annotated[
        int, tyro.conf.arg(help="local: processes at a time; 1: one job after the other, in this process")
    ] = 1
    cpus: Annotated[int, tyro.conf.arg(help="ray, slurm: cores kept free for a job")] = 1
    gpus: Annotated[int, tyro.conf.arg(help="ray, slurm: GPUs kept free for a job")] = 0
    memory_gb: Annotated[
        float | None, tyro.conf.arg(help="ray, slurm: memory kept free for a job, in 10^9 bytes")
    ] = None
    retries: Annotated[
        int,
        tyro.conf.arg(help="ray, slurm: how often a job is started anew that lost its machine or its time"),
    ] = 3
    address: Annotated[
        str | None,
        tyro.conf.arg(
            help="ray: address of a cluster",
            help_behavior_hint="(default: RAY_ADDRESS; else one on this machine)",
        ),
    ] = None
    hours: Annotated[float, tyro.conf.arg(help="slurm: time limit of a job")] = 24.0
    sbatch: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            help="slurm: further options of sbatch: partition=long account=robots",
            help_behavior_hint="(default: none)",
        ),
    ] = ()
    executor: Annotated[
        Literal["slurm", "local"],
        tyro.conf.arg(
            help="slurm: who runs the jobs; local: submitit itself, on this machine, to try it out"
        ),
    ] = "slurm"

    def __post_init__(self) -> None:
        for name, least in (("workers", 1), ("cpus", 1), ("gpus", 0), ("retries", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"--{name} must be at least {least}, got {getattr(self, name)}")
        for name, value in (("memory-gb", self.memory_gb), ("hours", self.hours)):
            if value is not None and value <= 0:
                raise ValueError(f"--{name} must be more than 0, got {value}")
        for option in self.sbatch:
            if not all(option.partition("=")):
                raise ValueError(f"--sbatch {option} is not of the form NAME=VALUE, as in partition=long")

    @property
    def in_this_process(self) -> bool:
        """Whether jobs run here, one after the other."""
        return self.runner == "local" and self.workers == 1

    @property
    def threads(self) -> int:
        """Cores that one job can count on: what a scheduler keeps free for it, or its part of this machine."""
        return self.cpus if self.runner != "local" else max(1, (os.cpu_count() or 1) // self.workers)
