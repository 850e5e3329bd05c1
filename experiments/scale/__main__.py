"""Measure what diagnoses, cells and jobs cost, and write docs/scale.md from what was measured.

python -m experiments.scale robots --joints 2 --runs 100 --out big
python -m experiments.fleet --model big/model.xml --robots big/robots --out big/fleet
python -m experiments.scale fleet big
python -m experiments.scale page
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from experiments import runners
from experiments.ending import exit_status
from experiments.scale import costs, overheads, page, robots
from mpge_jax import files

Table = Annotated[Path, tyro.conf.arg(help="folder of the measurements")]
KEPT = Path("docs/results/scale")


@dataclass(frozen=True)
class MakeRobots:
    """Writes robots to measure with: OUT/model.xml and OUT/robots."""

    out: Path
    robots: Annotated[robots.Robots, tyro.conf.arg(name="")]


@dataclass(frozen=True)
class OfFleet:
    """Keeps what diagnoses took: of FOLDER/fleet, which ran on FOLDER/model.xml and FOLDER/robots."""

    folders: tyro.conf.Positional[tuple[Path, ...]]
    kept: Table = KEPT


@dataclass(frozen=True)
class OfSweep:
    """Keeps what the cells of sweeps took."""

    folders: tyro.conf.Positional[tuple[Path, ...]]
    kept: Table = KEPT


@dataclass(frozen=True)
class OfJobs:
    """Measures a runner: jobs that do nothing."""

    count: int = 100
    kept: Table = KEPT
    options: Annotated[runners.Options, tyro.conf.arg(name="")] = field(default_factory=runners.Options)


@dataclass(frozen=True)
class OfComparison:
    """Measures the comparison of robots that never were."""

    robots: int = 10_000
    kept: Table = KEPT


@dataclass(frozen=True)
class WritePage:
    """Writes the page from what is kept."""

    out: Path = Path("docs/scale.md")
    kept: Table = KEPT


Command = (
    Annotated[MakeRobots, tyro.conf.subcommand("robots")]
    | Annotated[OfFleet, tyro.conf.subcommand("fleet")]
    | Annotated[OfSweep, tyro.conf.subcommand("sweep")]
    | Annotated[OfJobs, tyro.conf.subcommand("jobs")]
    | Annotated[OfComparison, tyro.conf.subcommand("comparison")]
    | Annotated[WritePage, tyro.conf.subcommand("page")]
)


def main(arguments: list[str] | None = None) -> int:
    """The command; returns its exit status."""

    def work() -> int:
        command = tyro.cli(Command, args=arguments, prog="python -m experiments.scale", description=__doc__)
        print(f"written: {_do(command)}")
        return 0

    return exit_status("scale", work, goes_on=False)


def _do(command: MakeRobots | OfFleet | OfSweep | OfJobs | OfComparison | WritePage) -> Path:
    if isinstance(command, MakeRobots):
        robots.write(command.robots, command.out)
        return command.out
    if isinstance(command, OfFleet):
        found = [
            row for f in command.folders for row in costs.of_fleet(f / "fleet", f / "model.xml", f / "robots")
        ]
        return costs.add(found, command.kept)
    if isinstance(command, OfSweep):
        return costs.add([row for f in command.folders for row in costs.of_sweep(f)], command.kept)
    if isinstance(command, OfJobs):
        return costs.add([overheads.measure_jobs(command.count, command.options)], command.kept)
    if isinstance(command, OfComparison):
        return costs.add([overheads.measure_comparison(command.robots)], command.kept)
    files.write_text(command.out, page.markdown(command.kept))
    return command.out


if __name__ == "__main__":
    sys.exit(main())
