"""One case, diagnosed with all rules watched or without one of them.

python -m experiments.ablation.one RULE --model M --recordings R --out OUT --seed 0 --jobs 1 --quiet

RULE `none`: with all of them. OUT/diagnosis.json is that of a diagnosis, OUT/acted.json lists the rules that changed an
answer of the function where they act.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from experiments.ablation.replaced import watched, without
from experiments.ablation.rules import gate
from mpge_jax import files
from mpge_jax.diagnosis import Config, diagnose

ALL = "none"


@dataclass(frozen=True)
class Args:
    """Diagnose one case without a rule."""

    rule: Annotated[str, tyro.conf.Positional]
    model: Path
    recordings: Path
    out: Path
    seed: int = 0
    jobs: int = 1
    quiet: bool = False


def main(args: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    given = tyro.cli(Args, args=args, description=__doc__)
    config = Config(seed=given.seed, jobs=given.jobs, quiet=given.quiet)
    with watched() if given.rule == ALL else without(gate(given.rule)) as acted:
        found = diagnose(given.model, given.recordings, config)
    given.out.mkdir(parents=True, exist_ok=True)
    files.write_text(given.out / "acted.json", json.dumps(sorted(acted or ())))
    files.write_text(given.out / "diagnosis.json", json.dumps(found.to_json(), indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
