"""`python -m experiments.second_author build | list`: write the cases of the second author, or name them.

python -m experiments.second_author build --out second
python -m experiments.blind run   --cases second/cases --out second/runs
python -m experiments.blind score --answers second/answers --runs second/runs --out second/score
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from experiments.ending import exit_status
from experiments.second_author.build import build
from experiments.second_author.cases import CASES


@dataclass(frozen=True)
class Build:
    """Record the machines (a few minutes for all); finished cases are kept."""

    out: Path
    """Cases go to OUT/cases (model.xml and recordings), answers to OUT/answers."""
    only: tuple[str, ...] = ()
    """Names of cases; all when empty."""
    seed: int = 0
    """Another one moves the same machines otherwise, with other noise."""


@dataclass(frozen=True)
class Names:
    """Name the cases with what they are."""


Command = Annotated[Build, tyro.conf.subcommand("build")] | Annotated[Names, tyro.conf.subcommand("list")]


def main(args: list[str] | None = None) -> int:
    """The command line; returns the exit status."""

    def work() -> int:
        command = tyro.cli(Command, args=args, description=__doc__)
        if isinstance(command, Names):
            for case in CASES:
                print(f"{case.name:20} {case.kind}")
            return 0
        if command.seed < 0:
            raise ValueError(f"--seed must not be negative, got {command.seed}")
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=Console(stderr=True)) as bar:
            task = bar.add_task("cases", total=None)

            def progress(done: int, total: int) -> None:
                bar.update(task, completed=done, total=total)

            build(command.out / "cases", command.out / "answers", command.only, command.seed, progress)
        return 0

    return exit_status("second_author", work)


if __name__ == "__main__":
    sys.exit(main())
