"""Diagnoses the public machines of a folder of recordings, and writes docs/atlas.md.

python -m experiments.atlas --recordings DIR
"""

import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from experiments.atlas import page, record
from experiments.atlas.machines import MACHINES, check_known
from experiments.ending import exit_status


@dataclass(frozen=True)
class Args:
    """Diagnoses the public machines that are not yet in the atlas, each of which takes minutes, and writes its page."""

    recordings: Annotated[
        Path | None,
        tyro.conf.arg(
            help="folder of the machines' recordings", help_behavior_hint=f"(default: ${record.FOLDER})"
        ),
    ] = field(default_factory=record.folder_given)
    machine: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            help=f"which: {', '.join(MACHINES)}; these anew, finished or not; none: the page alone"
        ),
    ] = tuple(MACHINES)
    jobs: Annotated[int, tyro.conf.arg(help="threads of a diagnosis")] = os.cpu_count() or 1
    docs: Annotated[Path, tyro.conf.arg(help="the folder of the documentation")] = Path("docs")


def check(args: Args) -> None:
    """Raises ValueError, one sentence, for what cannot be done."""
    check_known(args.machine)
    if args.jobs < 1:
        raise ValueError(f"--jobs must be at least 1, got {args.jobs}")


def missing(args: Args) -> list[str]:
    """The machines that are to be diagnosed: those asked for by name, or all that have no result yet."""
    if args.machine != tuple(MACHINES):
        return list(args.machine)
    return [key for key in args.machine if not record.kept(args.docs, key).is_file()]


def run(args: Args) -> None:
    """Diagnoses what is missing; each machine is kept before the next begins."""
    check(args)
    keys = missing(args)
    if keys and (args.recordings is None or not args.recordings.is_dir()):
        raise ValueError(
            f"{', '.join(keys)}: no result yet, and --recordings is no folder; give the one with the machines' "
            f"recordings, or set {record.FOLDER}"
        )
    for number, key in enumerate(keys, 1):
        print(f"[{number}/{len(keys)}] {key}", file=sys.stderr, flush=True)
        progress = args.docs / "results" / "atlas" / f".{key}.progress"
        assert args.recordings is not None
        progress.parent.mkdir(parents=True, exist_ok=True)
        d = record.diagnosed(MACHINES[key], args.recordings, args.jobs, progress)
        record.keep(d, MACHINES[key], args.recordings, args.docs)
        progress.unlink(missing_ok=True)


def main() -> int:
    """The command; returns its exit status."""
    return exit_status("atlas", _atlas)


def _atlas() -> int:
    args = tyro.cli(Args, prog="python -m experiments.atlas", description=Args.__doc__)
    run(args)
    page.write(args.docs)
    print(f"written: {args.docs / 'atlas.md'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
