"""Measures this library beside others, and writes docs/speed.md.

python -m experiments.benchmark.peers --row sac steps fit
"""

import json
import os
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from experiments.benchmark.peers import page
from experiments.benchmark.peers.rows import ROWS, install
from experiments.ending import exit_status
from experiments.storage import versions
from mpge_jax import files

_TOOL = "experiments.benchmark.peers"


@dataclass(frozen=True)
class Args:
    """Measures this library beside others that do the same work, in turn, and writes what it found as a page."""

    row: Annotated[
        tuple[str, ...], tyro.conf.arg(help=f"what to measure: {', '.join(ROWS)}; none: the page alone")
    ] = tuple(ROWS)
    rounds: Annotated[int, tyro.conf.arg(help="rounds that are measured, each with ours and every peer")] = 9
    kept: Annotated[Path, tyro.conf.arg(help="folder of the measurements, one file a row")] = Path(
        "docs/results/speed"
    )
    out: Annotated[Path, tyro.conf.arg(help="the page")] = Path("docs/speed.md")


def check(args: Args) -> None:
    """Raises ValueError, one sentence, for what cannot be measured."""
    for row in args.row:
        if row not in ROWS:
            raise ValueError(f"--row {row} is not known (allowed: {', '.join(ROWS)})")
    if args.rounds < 1:
        raise ValueError(f"--rounds must be at least 1, got {args.rounds}")


def measure(args: Args) -> None:
    """Measures the rows one after the other; each is kept before the next begins."""
    for name in args.row:
        before = os.getloadavg()
        row = ROWS[name](args.rounds)
        for peer in row["missing"]:
            print(f"{name}: {peer} is not installed, so it was not run: {install(peer)}", file=sys.stderr)
        record = {
            "command": shlex.join(["python", "-m", _TOOL, "--row", name, "--rounds", str(args.rounds)]),
            "versions": versions(),
            "load_average": [round(x, 1) for x in (before[0], os.getloadavg()[0])],
            **row,
        }
        files.write_text(args.kept / f"{name}.json", json.dumps(record, indent=1) + "\n")


def main() -> int:
    """The command; returns its exit status."""
    return exit_status("peers", _peers)


def _peers() -> int:
    args = tyro.cli(Args, prog=f"python -m {_TOOL}", description=Args.__doc__)
    check(args)
    measure(args)
    files.write_text(args.out, page.markdown(args.kept))
    page.draw(args.kept, args.out.parent)
    print(f"written: {args.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
