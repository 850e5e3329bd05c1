"""Diagnose every robot of a fleet, and put them beside each other.

python -m experiments.fleet --model robot.xml --robots DIR --out OUT
"""

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from experiments import runners
from experiments.ending import exit_status
from experiments.fleet import changes, page, picture, robot, table
from experiments.fleet.comparison import Fleet, compare
from experiments.fleet.found import found_of
from mpge_jax import files
from mpge_jax.diagnosis import REGISTRY, load_effects, load_readers
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec
from mpge_jax.diagnosis.recordings.column_map import load


@dataclass(frozen=True)
class Args:
    """Diagnoses every robot of a fleet, and says what all share, what is one robot's own, and what changed since."""

    model: Annotated[Path, tyro.conf.arg(help="MJCF or URDF file of the nominal model, one for all robots")]
    robots: Annotated[Path, tyro.conf.arg(help="folder with one folder of recordings for each robot")]
    out: Annotated[Path, tyro.conf.arg(help="folder for the results")] = Path("fleet")
    before: Annotated[
        Path | None, tyro.conf.arg(help="--out of an earlier run on the same robots, to say what changed")
    ] = None
    effects: Annotated[
        tuple[str, ...],
        tyro.conf.arg(help="effects to try", help_behavior_hint="(default: all)", metavar="ID ..."),
    ] = ()
    effects_file: Annotated[
        tuple[Path, ...],
        tyro.conf.arg(
            help="Python files that register effects of your own", help_behavior_hint="(default: none)"
        ),
    ] = ()
    reader_file: Annotated[
        tuple[Path, ...],
        tyro.conf.arg(
            help="Python files that register readers of your own for logs",
            help_behavior_hint="(default: none)",
        ),
    ] = ()
    map: Annotated[Path | None, tyro.conf.arg(help="YAML file that renames and converts columns")] = None
    seed: Annotated[int, tyro.conf.arg(help="seed of every random choice")] = 0
    options: Annotated[runners.Options, tyro.conf.arg(name="")] = field(default_factory=runners.Options)


def fleet(args: Args) -> int:
    """Diagnoses every robot that has no diagnosis yet, and writes the pages; returns the number of robots that failed.

    Raises:
      ValueError: what is asked for cannot be done, in one sentence; nothing is written then.
    """
    settings = _checked(args)
    identity = settings.identity()
    before = None if args.before is None else table.read(args.before)
    if not args.robots.is_dir():
        raise ValueError(
            f"--robots {args.robots} is not a folder: it needs one folder of recordings for each robot"
        )
    record = args.out / "settings.json"
    _check_out(args.out, record, identity)
    console = Console(stderr=True)
    with files.held(args.out):
        jobs = robot.jobs_of(settings, args.robots, args.out / "robots")
        files.write_text(record, json.dumps(identity, indent=1))
        for number, ended in enumerate(runners.run(jobs, args.options, args.out / "jobs"), 1):
            robot.keep_outcome(ended, args.out / "robots")
            console.print(
                f"[{number}/{len(jobs)}] {_told(ended)}", highlight=False, markup=False, soft_wrap=True
            )
        found, failed = robot.tables(jobs)
        result = compare(found_of(found), failed)
        _write(result, args.out, identity, None if before is None else changes.changes_of(result, *before))
    print(page.lead(result))
    print(f"report: {args.out / 'fleet.html'}")
    return len(result.failed)


def _checked(args: Args) -> robot.Settings:
    """What all robots have in common, looked at before any of them."""
    runners.check(args.options)
    compile_variable(load_spec(args.model))
    for file in args.effects_file:
        load_effects(file)
    for file in args.reader_file:
        load_readers(file)
    if args.map is not None:
        load(args.map)
    unknown = [effect for effect in args.effects if effect not in REGISTRY]
    if unknown:
        known = ", ".join(name for name in REGISTRY if ":" not in name)
        raise ValueError(f"--effects {unknown[0]} is not known (known: {known})")
    settings = robot.Settings(
        model=args.model.resolve(),
        effects=args.effects or None,
        effects_files=tuple(path.resolve() for path in args.effects_file),
        reader_files=tuple(path.resolve() for path in args.reader_file),
        map=None if args.map is None else args.map.resolve(),
        seed=args.seed,
        threads=args.options.threads,
    )
    settings.config()
    return settings


def _check_out(out: Path, record: Path, identity: dict[str, object]) -> None:
    """Raises ValueError for a folder of another fleet, or of something else."""
    try:
        other = json.loads(record.read_text()) if record.exists() else None
    except ValueError:
        raise ValueError(f"{record} cannot be read; move the folder away or choose another --out") from None
    if other is not None and other != identity:
        differing = sorted(k for k in {*other, *identity} if other.get(k) != identity.get(k))
        raise ValueError(f"{out} holds another fleet ({', '.join(differing)} differ); choose another --out")
    if other is None and out.exists():
        left = {".lock", "settings.json.partial"}
        if not out.is_dir() or {path.name for path in out.iterdir()} - left:
            raise ValueError(f"--out {out} is not empty and holds no fleet; choose another one")


def _told(ended: runners.Ended) -> str:
    if ended.state == "before":
        return f"{ended.name}: done before"
    if ended.state == "failed":
        return f"{ended.name}: failed, {ended.reason}"
    return f"{ended.name}: done" + ("" if ended.cost is None else f", {ended.cost.seconds:.0f} s")


def _write(result: Fleet, out: Path, identity: dict[str, object], changed: dict[str, object] | None) -> None:
    drawn = picture.draw(result, out / "fleet.png")
    if drawn is None:
        (out / "fleet.png").unlink(missing_ok=True)
    files.write_text(out / "fleet.md", page.markdown(result, changed, drawn is not None))
    files.write_text(out / "fleet.html", page.html(result, changed, drawn))
    text = json.dumps(table.fleet_table(result, identity, changed), indent=1, allow_nan=False)
    files.write_text(out / table.NAME, text)


def main() -> int:
    """The command: 0 where every robot has a diagnosis, 1 where some failed, 2 for bad input, 130 when interrupted."""

    def work() -> int:
        return 1 if fleet(tyro.cli(Args, prog="python -m experiments.fleet", description=Args.__doc__)) else 0

    return exit_status("fleet", work)


if __name__ == "__main__":
    sys.exit(main())
