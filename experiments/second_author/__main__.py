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

from experiments.ending import exit_status
from experiments.second_author.build import build, wanted
from experiments.second_author.cases import CASES
from mpge_jax.progress import ProgressBar


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
        command = tyro.cli(
            Command, args=args, prog="python -m experiments.second_author", description=__doc__
        )
        if isinstance(command, Names):
            for case in CASES:
                print(f"{case.name:20} {case.kind}")
            return 0
        if command.seed < 0:
            raise ValueError(f"--seed must not be negative, got {command.seed}")
        with ProgressBar("cases", len(wanted(command.only))) as bar:
            build(command.out / "cases", command.out / "answers", command.only, command.seed, bar.advance)
        return 0

    return exit_status("second_author", work)


if __name__ == "__main__":
    sys.exit(main())
