"""`python -m experiments.ablation run | public | table`: the diagnosis without each of its rules, on blind cases;
and which of them act on public machines.

python -m experiments.blind build --out cases61 --seed 61
python -m experiments.ablation run --cases cases61 --out ablation --workers 2
python -m experiments.ablation public --recordings recordings --out ablation
python -m experiments.ablation table --cases cases61 --out ablation --page docs/ablation.md
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from experiments import runners
from experiments.ablation import table
from experiments.ablation.compared import Case, acted, cases_of, effect, note, place, public
from experiments.ablation.one import ALL
from experiments.ablation.replaced import watched
from experiments.ablation.rules import GATES, gate
from experiments.atlas.machines import MACHINES
from experiments.atlas.record import diagnosed
from experiments.blind.run import CaseJob, run_case
from experiments.ending import exit_status
from experiments.marked_page import put_between
from experiments.runners import Job, Options
from mpge_jax import files


@dataclass(frozen=True)
class Run:
    """Diagnose all cases as they are, then without each rule where it acted; finished ones are skipped."""

    cases: tuple[Path, ...]
    """Folders that `experiments.blind build` wrote."""
    out: Path
    rule: tuple[str, ...] = ()
    """Rules to switch off; all when empty."""
    first: int | None = None
    """How many of the cases, in an order of their own; all when not given."""
    timeout: float = 900.0
    """Seconds after which a diagnosis is given up."""
    options: Annotated[Options, tyro.conf.arg(name="")] = field(default_factory=Options)


@dataclass(frozen=True)
class Public:
    """Diagnose public machines with all rules watched; finished ones are skipped."""

    recordings: Path
    """Folder of the machines' folders (`experiments.atlas`)."""
    out: Path
    machine: tuple[str, ...] = ()
    """Which; all that are there when empty."""


@dataclass(frozen=True)
class Table:
    """Write the table from what was run."""

    cases: tuple[Path, ...]
    """Folders that `experiments.blind build` wrote."""
    out: Path
    page: Path = Path("docs/ablation.md")
    """In which it stands between two marks."""
    built: tuple[str, ...] = ()
    """Of each of the folders its name and the further arguments that it was built with, to be shown."""


Command = (
    Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Public, tyro.conf.subcommand("public")]
    | Annotated[Table, tyro.conf.subcommand("table")]
)


def work_of(out: Path, rule: str, case: Case, timeout: float) -> Job:
    """The job of one diagnosis."""
    command = (sys.executable, "-m", "experiments.ablation.one", rule)
    given = CaseJob(case.folder, place(out, rule, case), 1, 0, timeout, command)
    return Job(f"{rule}: {case.name}", run_case, given, given.note)


def run(command: Run) -> None:
    """All cases; then, a few of each rule in turn, until each is known to be needed or has been tried on all."""
    cases, out = cases_of(command.cases), command.out.resolve()
    rules = [gate(name).name for name in command.rule] or [g.name for g in GATES]
    rng = np.random.default_rng(0)
    cases = [cases[k] for k in rng.permutation(len(cases))][: command.first]

    def go(jobs: list[Job], what: str) -> None:
        for number, each in enumerate(runners.run(jobs, command.options, out / "jobs"), 1):
            if each.state == "failed":
                print(f"{each.name}: {each.reason}", file=sys.stderr)
            print(f"{what}: {number} of {len(jobs)}", file=sys.stderr)

    go([work_of(out, ALL, c, command.timeout) for c in cases], "all rules")
    acts = {c: acted(out, c) for c in cases}
    while True:
        jobs, left = [], 0
        for rule in rules:
            if effect(out, rule, acts).needed:
                continue
            waiting = [c for c in cases if rule in acts[c] and not note(out, rule, c).exists()]
            jobs += [work_of(out, rule, c, command.timeout) for c in waiting[:2]]
            left += len(waiting)
        if not jobs:
            return
        go(jobs, f"rules switched off, at most {left} to go")


def watch_public(command: Public) -> None:
    """Which rules act on each of the machines; one process, one thread."""
    for key in command.machine or MACHINES:
        if key not in MACHINES:
            raise ValueError(f"there is no machine {key!r} (there are: {', '.join(MACHINES)})")
        there = (command.recordings / MACHINES[key].folder / "model.xml").exists()
        target = public(command.out, key)
        if not there and command.machine:
            raise ValueError(f"{command.recordings} has no {MACHINES[key].folder}")
        if there and not target.exists():
            with watched() as acts:
                diagnosed(MACHINES[key], command.recordings, jobs=1)
            files.write_text(target, json.dumps(sorted(acts)))


def main(args: list[str] | None = None) -> int:
    """The command line; returns the exit status."""

    def work() -> int:
        command = tyro.cli(Command, args=args, prog="python -m experiments.ablation", description=__doc__)
        if isinstance(command, Run):
            run(command)
            return 0
        if isinstance(command, Public):
            watch_public(command)
            return 0
        folders = " ".join(p.name for p in command.cases)
        said = [
            *(f"python -m experiments.blind build --out {built}" for built in command.built),
            f"python -m experiments.ablation run --cases {folders} --out {command.out.name}",
        ]
        text = table.text(command.out.resolve(), cases_of(command.cases), "\n    ".join(said))
        put_between(command.page, table.BEGIN, table.END, text)
        return 0

    return exit_status("ablation", work)


if __name__ == "__main__":
    sys.exit(main())
