"""Writes docs/results.md from what was measured: sweeps, benchmarks and the policies that ship with the project.

python -m experiments.results results/SkewedPendulum-quick results/benchmark

No number in it is typed: run the command again and the page is made anew from the folders that it is given.
"""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from experiments.benchmark import table
from experiments.ending import exit_status
from experiments.results import comparison
from experiments.results.section import image, sweep_section
from experiments.results.sweeps import Sweep, read_json, read_sweep
from mpge_jax import files
from mpge_jax.rollouts import policies

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Args:
    """Writes the page of results from the folders of sweeps and benchmarks."""

    folders: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(
            help="folders of sweeps and benchmarks", help_behavior_hint="(default: all in results)"
        ),
    ] = ()
    out: Annotated[Path, tyro.conf.arg(help="the page; pictures go into images beside it")] = Path(
        "docs/results.md"
    )


def policies_section() -> str:
    """The policies that ship with the project: returns in the source, and how they were trained."""
    lines = [
        "`python -m experiments.pretrain --task TASK --kind KIND` (ER sets: `--entropy-coefficient 0.1` or "
        "`0.01`), evaluated over 50 episodes of the source task for each policy:",
        "",
        "| task | kind, entropy coefficient | policies | return, deterministic: mean (least to most) "
        "| return, stochastic | SAC updates | environment steps | kept of each training "
        "| batch, learning rate | seed | machine |",
        "|---|---|--:|--:|--:|--:|--:|---|---|--:|---|",
    ]
    tasks = [name for name in envs.names() if envs.source_of(name) == name]
    for task in tasks:
        for kind, coefficient in (("MS", 0.1), ("ER", 0.1), ("ER", 0.01)):
            label = kind if kind == "MS" else f"{kind}, {coefficient:g}"
            if not policies.shipped_path(task, kind, coefficient).is_file():
                lines.append(f"| {task} | {label} | none shipped | | | | | | | | |")
                continue
            stored, about = policies.shipped(task, kind, coefficient)
            sac = about.get("config", {}).get("sac", {})
            returns = about.get("returns", {})
            lines.append(
                f"| {task} | {label} | {stored.size} | {_range(returns.get('deterministic'))} "
                f"| {_range(returns.get('stochastic'))} | {_number(about.get('updates'))} "
                f"| {_number(about.get('env_steps'))} | {about.get('kept', 'its end, by an earlier version')} "
                f"| {sac.get('batch_size', '')}, {sac.get('actor_lr', '')} "
                f"| {about.get('seed', '')} | {about.get('machine', '')} |"
            )
    return "\n".join(lines)


def _range(values: list[float] | None) -> str:
    return f"{np.mean(values):,.0f} ({min(values):,.0f} to {max(values):,.0f})" if values else ""


def _number(value: int | None) -> str:
    return "" if value is None else f"{value:,}"


def find(folders: tuple[Path, ...]) -> tuple[list[Path], list[Path]]:
    """Folders of sweeps with results, and of benchmarks, among `folders` (or in `results`).

    Raises:
      ValueError: a folder that is neither, two of one name, or nothing at all.
    """
    chosen = folders or tuple(sorted(path for path in Path("results").glob("*") if path.is_dir()))
    sweeps, benchmarks = [], []
    for folder in chosen:
        if (folder / "results.json").is_file():
            sweeps.append(folder)
        elif (folder / "benchmark.json").is_file():
            benchmarks.append(folder)
        elif folders:
            raise ValueError(
                f"{folder} holds neither a sweep (results.json) nor a benchmark (benchmark.json)"
            )
    names = [folder.resolve().name for folder in sweeps]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two folders are called {name}; their pictures would overwrite each other")
    if not sweeps and not benchmarks:
        raise ValueError("there is nothing in results yet; run `make sweep` first, or name the folders")
    return sweeps, benchmarks


def _shown(folder: Path) -> str:
    """A folder as in the command: those that the project keeps lie in docs/results, all others in results."""
    kept = (ROOT / "docs" / "results").resolve()
    home = "docs/results" if folder.resolve().parent == kept else "results"
    return f"{home}/{folder.resolve().name}"


def comparison_section(sweeps: list[Sweep], images: Path, out: Path) -> list[str]:
    """Methods against each other and against the paper, for the tasks of the sweeps: paragraphs of Markdown."""
    by_sweep = {f"{s.identity['task']}, {s.identity['preset']['name']}": s.rows for s in sweeps}
    parts, found = [], comparison.shares_by_task(by_sweep)
    if found:
        picture = images / f"{out.stem}-shares.png"
        images.mkdir(parents=True, exist_ok=True)
        comparison.shares_figure(found, picture)
        told = "\n".join(comparison.shares_table(found))
        parts += ["## From direct to target", told, image("Shares of the way", picture, out)]
    # quick runs have budgets of their own, far from the paper's
    by_task = {s.identity["task"]: s.rows for s in sweeps if s.identity["preset"]["name"] != "quick"}
    if beside := comparison.paper_tables(by_task):
        parts += ["## Beside the paper", "\n".join(beside).rstrip()]
    return parts


def page(args: Args) -> str:
    """The whole page, whose pictures are copied beside it."""
    sweeps, benchmarks = find(args.folders)
    images = args.out.parent / "images"
    read = [read_sweep(folder) for folder in sweeps]
    records = [read_json(folder / "benchmark.json") for folder in benchmarks]
    listed = shlex.join([_shown(folder) for folder in (*sweeps, *benchmarks)])
    listed += "" if args.out.name == "results.md" else f" --out docs/{args.out.name}"
    parts = [
        "# Results",
        f"Written by `python -m experiments.results {listed}` from the files that these runs left; nothing here is "
        "typed by hand. Returns are mean ± standard deviation over seeds (each the mean of its evaluation episodes), "
        "with the 95 % interval of the mean over seeds (Student's t): methods whose intervals overlap are not told "
        "apart. "
        "`target` trains on in the target from the same source policy within the preset's budget, which is no upper "
        "bound; "
        "`paper` is the mean that the paper's tables report, under the paper's own budgets.",
    ]
    if read:
        parts += ["## Sweeps", *(sweep_section(sweep, images, args.out) for sweep in read)]
        parts += comparison_section(read, images, args.out)
    parts += ["## Source policies", policies_section()]
    if records:
        parts += ["## Speed", *(table.markdown(record).rstrip() for record in records)]
    return "\n\n".join(parts) + "\n"


def main() -> int:
    """The command; returns its exit status."""

    def work() -> int:
        args = tyro.cli(Args, prog="python -m experiments.results", description=Args.__doc__)
        files.write_text(args.out, page(args))
        print(f"written: {args.out}")
        return 0

    return exit_status("results", work, goes_on=False)
