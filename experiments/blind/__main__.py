"""`python -m experiments.blind build | run | told | score`: draw the cases, run the diagnosis on each, fit the sizes of
the true effects beside it, mark the answers.

Seeds: 1 to 99 are for building and tuning, 100 and above for reporting; a reported seed is run once.

    python -m experiments.blind build --out blind --seed 101
    python -m experiments.blind run   --cases blind/cases --out blind/runs
    python -m experiments.blind told  --cases blind/cases --answers blind/answers --out blind/told
    python -m experiments.blind score --answers blind/answers --runs blind/runs --told blind/told --out blind/score
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from experiments.blind.build import Counts as CaseCounts
from experiments.blind.build import build
from experiments.blind.case import Unfit
from experiments.blind.run import run_all
from experiments.blind.scoring.score import put_into, write_score
from experiments.blind.told import write_rivals
from experiments.ending import exit_status
from experiments.runners import Options


@dataclass(frozen=True)
class Build:
    """Draw machines with hidden physics and record them."""

    out: Path
    """Cases go to OUT/cases (model.xml and recordings), answers to OUT/answers."""
    seed: int
    """1 to 99 for building and tuning, from 100 on for reporting."""
    counts: Annotated[CaseCounts, tyro.conf.arg(name="")] = field(default_factory=CaseCounts)
    answers: Path | None = None
    """Another folder for the answers."""


@dataclass(frozen=True)
class Run:
    """Run the diagnosis on every case, one process each; finished cases are skipped."""

    cases: Path
    out: Path
    only: tuple[str, ...] = ()
    """Names of cases; all when empty."""
    jobs: int = 2
    """Passed on to the diagnosis."""
    seed: int = 0
    """Passed on to the diagnosis."""
    timeout: float = 900.0
    """Seconds after which a case is given up."""
    retry_failed: bool = False
    """Run cases again that ended with an error."""
    options: Annotated[Options, tyro.conf.arg(name="")] = field(default_factory=Options)
    """Times of cases that ran beside others are those of a busy machine."""


@dataclass(frozen=True)
class Told:
    """Fit the true effects' sizes in every case where all is in the vocabulary; finished cases are skipped."""

    cases: Path
    answers: Path
    out: Path


@dataclass(frozen=True)
class Score:
    """Mark the reports against the answers; writes score.md and score.json."""

    answers: Path
    runs: Path
    out: Path
    alone: Path | None = None
    """Runs of some of these cases once more, by themselves on the machine: their times count."""
    told: Path | None = None
    """What the rivals found that were told the answer."""
    kept: Path | None = None
    """A score.json of other cases of this set, whose runs are no more: their marks count."""
    page: Path | None = None
    """A Markdown page that shows the score between two marks, such as docs/accuracy.md."""


Command = (
    Annotated[Build, tyro.conf.subcommand("build")]
    | Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Told, tyro.conf.subcommand("told")]
    | Annotated[Score, tyro.conf.subcommand("score")]
)


def main(args: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )

    def work() -> int:
        command = tyro.cli(Command, args=args, prog="python -m experiments.blind", description=__doc__)
        if isinstance(command, Score):
            text = write_score(
                command.answers, command.runs, command.out, command.alone, command.told, command.kept
            )
            if command.page is not None:
                put_into(command.page, text)
            print(text)
            return 0
        with Progress(*columns, console=Console(stderr=True)) as bar:
            task = bar.add_task("cases", total=None)

            def progress(done: int, total: int) -> None:
                bar.update(task, completed=done, total=total)

            if isinstance(command, Build):
                answers = command.answers or command.out / "answers"
                try:
                    build(command.out / "cases", answers, command.seed, command.counts, progress)
                except Unfit as problem:
                    raise ValueError(str(problem)) from None
            elif isinstance(command, Told):
                write_rivals(command.cases, command.answers, command.out, progress)
            else:
                run_all(
                    command.cases,
                    command.out,
                    only=command.only,
                    jobs=command.jobs,
                    seed=command.seed,
                    timeout=command.timeout,
                    retry_failed=command.retry_failed,
                    progress=progress,
                    options=command.options,
                )
        return 0

    return exit_status("blind", work)


if __name__ == "__main__":
    sys.exit(main())
