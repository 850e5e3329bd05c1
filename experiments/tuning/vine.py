"""What each change that `Vine` makes to the paper's grounding brings: one taken back, or one alone, at a time.

python -m experiments.tuning.vine --out docs/results/vine

Grounds one transformer for each seed in BrokenCheetah with the preset `standard`, and writes docs/vine.md. What is done
is not run again. Nothing is chosen by it: the presets were chosen on tasks of their own (docs/tuning.md).
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from experiments.ending import exit_status
from experiments.presets import STANDARD
from experiments.tuning.trial import spread, trial
from mpge_jax import files
from mpge_jax.grounding.config import GroundingConfig

TASK = "BrokenCheetah"
SAMPLES = (500, 5_000)
SEEDS = 3

# The settings that each change consists of.
CHANGES: Mapping[str, tuple[str, ...]] = {
    "several draws at a state": ("steps_per_iteration", "branches"),
    "D judges what the target adds": ("discriminator.next_as",),
    "a smaller penalty of D": ("discriminator.penalty_coefficient",),
    "average of the iterates": ("averaging",),
}


def variants(paper: GroundingConfig, vine: GroundingConfig) -> dict[str, GroundingConfig]:
    """By name: the paper's structure, `Vine`, and every change of `CHANGES` taken back alone, or made alone."""
    return {
        "Vine": vine,
        **{f"Vine without: {change}": _with(vine, paper, change) for change in CHANGES},
        "MPG-MS": paper,
        **{f"MPG-MS with: {change}": _with(paper, vine, change) for change in CHANGES},
    }


def _with(config: GroundingConfig, other: GroundingConfig, change: str) -> GroundingConfig:
    """`config`, but what `change` consists of as in `other`."""
    for path in CHANGES[change]:
        holder, _, name = path.rpartition(".")
        if holder:
            part = replace(getattr(config, holder), **{name: getattr(getattr(other, holder), name)})
            config = replace(config, **{holder: part})
        else:
            config = replace(config, **{name: getattr(other, name)})
    return config


def standard() -> dict[str, GroundingConfig]:
    """The variants, as the preset `standard` has both structures."""
    paper = STANDARD.tasks[envs.source_of(TASK)].grounding
    return variants(paper, STANDARD.vine.grounding(paper))


@dataclass(frozen=True)
class Args:
    """Grounds with every variant that is not done yet, and writes the page."""

    out: Annotated[Path, tyro.conf.arg(help="folder of the results")] = Path("docs/results/vine")
    page: Annotated[Path, tyro.conf.arg(help="the page")] = Path("docs/vine.md")
    samples: Annotated[tuple[int, ...], tyro.conf.arg(help="transitions recorded in the target")] = SAMPLES
    backend: Annotated[str, tyro.conf.arg(help="physics: " + ", ".join(envs.BACKENDS))] = "auto"
    variant: Annotated[tuple[str, ...], tyro.conf.arg(help="which", help_behavior_hint="(default: all)")] = (
        tuple(standard())
    )

    def __post_init__(self) -> None:
        if self.backend not in envs.BACKENDS:
            raise ValueError(f"--backend: {self.backend!r} is none of: {', '.join(envs.BACKENDS)}.")
        unknown = [name for name in self.variant if name not in standard()]
        if unknown:
            raise ValueError(f"--variant: {unknown[0]!r} is none of: {', '.join(standard())}.")


def record(out: Path, variant: str, samples: int) -> Path:
    """The file of one result."""
    return out / f"{variant.replace(': ', '-').replace(' ', '_')}-{samples}.json"


def stored(out: Path) -> list[dict[str, Any]]:
    """All results of the folder, in the page's order."""
    paths = [record(out, variant, samples) for samples in SAMPLES for variant in standard()]
    return [json.loads(path.read_text()) for path in paths if path.is_file()]


def markdown(rows: list[dict[str, Any]]) -> str:
    """The page."""
    lines = [
        "# What each change of Vine brings",
        "",
        "Written by `python -m experiments.tuning.vine` from `docs/results/vine`. `MPG-MS` has the paper's "
        "structure, `Vine` is this project's ([grounding.md](grounding.md)); each change between them is taken back "
        f"alone, or made alone. {TASK}, preset `standard`, one transformer and five policies (`MS`), {SEEDS} seeds, "
        "as many transitions a policy update in all rows. Figures: action-transformation error on logged states at "
        "the end of the run, mean of its last five iterations; mean (least to most) over seeds. Nothing was chosen by "
        "this page: the presets were, on other tasks ([tuning.md](tuning.md)). A variant without a row has not been "
        "run.",
    ]
    for samples in dict.fromkeys(row["samples"] for row in rows):
        lines += [
            "",
            f"## {samples:,} target transitions",
            "",
            "| | simulator steps | uniform random actions | at a quarter of the run | the policies' own actions |",
            "|---|--:|--:|--:|--:|",
        ]
        lines += [
            f"| {row['variant']} | {row['simulator_steps']:,} | {spread(row['errors']['1.0'])} "
            f"| {spread(row['errors']['0.25'])} | {spread(row['errors_own']['1.0'])} |"
            for row in rows
            if row["samples"] == samples
        ]
    machines = dict.fromkeys(
        f"Machine: {r['versions']['machine']}, commit {r['versions']['commit']}." for r in rows
    )
    lines += ["", *(machines or ["None has been run yet."])]
    return "\n".join(lines) + "\n"


def main() -> int:
    """The command; returns its exit status."""
    return exit_status("tuning.vine", _run)


def _run() -> int:
    args = tyro.cli(Args, prog="python -m experiments.tuning.vine", description=Args.__doc__)
    configs = standard()
    for samples in args.samples:
        for name in args.variant:
            path = record(args.out, name, samples)
            if not path.is_file():
                title = f"{name}, {samples:,} transitions"
                found = trial(TASK, configs[name], samples, SEEDS, title, args.backend)
                files.write_text(path, json.dumps({**found, "variant": name}, indent=1) + "\n")
    files.write_text(args.page, markdown(stored(args.out)))
    print(f"written: {args.page}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
