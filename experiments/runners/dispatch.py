"""The one way to run jobs: those that are done are skipped, the others go to the runner that was asked for."""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

from experiments.runners.job import Ended, Job
from experiments.runners.options import Options

Runner = Callable[[Sequence[Job], Options, Path], Iterator[Ended]]
"""What the module of every runner has by the name `run`."""
_MODULES = {"local": "local", "ray": "ray_cluster", "slurm": "slurm"}
_NEEDS = {"ray": "ray", "slurm": "submitit"}


def check(options: Options) -> None:
    """Raises ValueError where the runner lacks a package, with the line that installs it."""
    package = _NEEDS.get(options.runner)
    if package is not None and find_spec(package) is None:
        raise ValueError(
            f"--runner {options.runner} needs {package}, which is not installed: "
            f"pip install 'mpge-jax[{options.runner}]' (in a checkout: pip install -e '.[{options.runner}]')"
        )


def run(jobs: Sequence[Job], options: Options, logs: Path) -> Iterator[Ended]:
    """Runs jobs and tells how each ended, as it ends; jobs that were done before come first.

    Args:
      jobs: of different names, each with a folder of its own.
      options: where.
      logs: folder for what a scheduler writes.

    Raises:
      ValueError: two jobs of one name or one folder, or a package is missing.
    """
    check(options)
    for what, each in (("name", [j.name for j in jobs]), ("folder", [str(j.result.parent) for j in jobs])):
        twice = [value for value, count in Counter(each).items() if count > 1]
        if twice:
            raise ValueError(f"two jobs have the {what} {twice[0]}")
    module = importlib.import_module(f"experiments.runners.{_MODULES[options.runner]}")
    return _run(jobs, options, logs, module.run)


def _run(jobs: Sequence[Job], options: Options, logs: Path, runner: Runner) -> Iterator[Ended]:
    todo = []
    for job in jobs:
        if job.result.exists():
            yield Ended(job.name, "before")
        else:
            todo.append(job)
    if todo:
        yield from runner(todo, options, logs)
