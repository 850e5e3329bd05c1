"""Writes docs/results.md from what was measured: sweeps, benchmarks and the policies that ship with the project.

python -m experiments.results results/SkewedPendulum-quick results/benchmark

No number in it is typed: run the command again and the page is made anew from the folders that it is given.
"""

import json
import os
import re
import shlex
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from experiments import report
from experiments.benchmark import table
from experiments.ending import exit_status
from experiments.methods import METHODS
from mpge_jax import files
from mpge_jax.loop import Curve
from mpge_jax.rollouts import policies

ROOT = Path(__file__).resolve().parents[1]
SHARES = (0.05, 0.1, 0.25, 0.5, 1.0)


@dataclass(frozen=True)
class Args:
    """Writes the page of results from the folders of sweeps and benchmarks."""

    folders: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(help="folders of sweeps and benchmarks (default: all in results)"),
    ] = ()
    out: Annotated[Path, tyro.conf.arg(help="the page; pictures go into images beside it")] = Path(
        "docs/results.md"
    )


@dataclass(frozen=True)
class Sweep:
    """What a sweep left in its folder.

    Attributes:
      name: of the folder.
      identity: what all its cells share.
      versions: of packages, and the machine.
      rows: one for each method, number of samples and seed.
      curves: of grounding, by method and samples.
      failures: what each cell that failed raised.
      pictures: that it drew.
    """

    name: str
    identity: dict[str, Any]
    versions: dict[str, str]
    rows: list[dict[str, Any]]
    curves: dict[tuple[str, int], Curve]
    failures: dict[str, str]
    pictures: list[Path]

    @property
    def command(self) -> str:
        """The command line that makes this sweep."""
        i = self.identity
        samples = sorted({row["samples"] for row in self.rows if row["samples"]})
        words = ["python", "-m", "experiments.sweep", "--task", i["task"]]
        words += ["--method", *(m for m in METHODS if any(row["method"] == m for row in self.rows))]
        words += ["--samples", *map(str, samples)] if samples else []
        words += ["--seeds", str(i["seeds"]), "--preset", i["preset"]["name"]]
        for option, usual in (("backend", "auto"), ("dynamics", "mujoco")):
            words += [f"--{option}", i[option]] if i[option] != usual else []
        return shlex.join(words)


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read ({type(error).__name__}: {error})") from error


def read_sweep(folder: Path) -> Sweep:
    """Reads a sweep's folder.

    Raises:
      ValueError: a file of it is damaged; says which.
    """
    record = _read_json(folder / "results.json")
    curves = {}
    for file in sorted((folder / "cells").glob("*/curve.npz")):
        method, samples = file.parent.name.rsplit("-", 1)
        try:
            with np.load(file, allow_pickle=False) as arrays:
                curves[method, int(samples)] = {name: arrays[name] for name in arrays.files}
        except Exception as error:
            raise ValueError(f"{file} is damaged ({type(error).__name__}: {error})") from error
    failures = {
        file.parent.name: _summary(_read_json(file)["error"])
        for file in sorted((folder / "cells").glob("*/error.json"))
        if not (file.parent / "result.json").exists()
    }
    if "target_log" in record.get("identity", {}):
        raise ValueError(f"{folder} was made from a recorded log and has no returns; read its own results.md")
    try:
        return Sweep(
            name=folder.resolve().name,
            identity=record["identity"],
            versions=record["versions"],
            rows=record["rows"],
            curves=curves,
            failures=failures,
            pictures=[folder / name for name in ("returns.png", "errors.png") if (folder / name).is_file()],
        )
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"{folder / 'results.json'} is not what a sweep writes: {error} is missing"
        ) from error


def _summary(trace: str) -> str:
    """What was raised, from a traceback; XLA's messages go on over many lines, of which the first tells most."""
    lines = trace.strip().splitlines()
    raised = [line for line in lines if re.match(r"[A-Za-z_][\w.]*(: |$)", line)]
    return (raised or lines)[-1]


def budgets(identity: dict[str, Any]) -> str:
    """One sentence on what each cell of a sweep was given."""
    preset = identity["preset"]
    known = identity["task"] in envs.names()
    settings = preset["tasks"].get(envs.source_of(identity["task"])) if known else None
    shared = (
        f"{preset['policies']} rollout policies (one for SPG), ensembles of {preset['members']}, "
        f"evaluation over {preset['episodes']} episodes"
    )
    if settings is None:
        return f"Budget: {shared}."
    grounding, agent = settings["grounding"], settings["agent"]
    batch = grounding["num_envs"] * grounding["steps_per_iteration"]
    return (
        f"Budget: {grounding['iterations']:,} grounding iterations of {batch:,} transitions for each transformer, "
        f"{settings['agent_updates']:,} SAC updates of batch {agent['sac']['batch_size']} for each agent, {shared}."
    )


def seconds_table(sweep: Sweep) -> list[str]:
    """Wall time of every cell, all seeds together."""
    spent: dict[tuple[str, int], list[float]] = {}
    resumed = {(row["method"], row["samples"]) for row in sweep.rows if row.get("resumed")}
    for row in sorted(sweep.rows, key=_place):
        times = spent.setdefault((row["method"], row["samples"]), [0.0, 0.0])
        times[0] += row.get("seconds", float("nan")) / 60
        times[1] += row.get("grounding_seconds", 0.0) / 60
    parts = [
        f"{method}{f' at {samples:,}' if samples else ''} {whole:.1f}"
        + (f" (grounding {grounding:.1f})" if grounding > 0 else "")
        + (" since it was interrupted" if (method, samples) in resumed else "")
        for (method, samples), (whole, grounding) in spent.items()
    ]
    return [f"Wall time in minutes, all seeds of a cell together: {'; '.join(parts)}."]


def curve_table(sweep: Sweep) -> list[str]:
    """Action-transformation error in the course of grounding, mean over seeds and members."""
    curves = {cell: curve for cell, curve in sweep.curves.items() if "error_uniform" in curve}
    if not curves:
        return []
    heads = [f"{share:.0%}" for share in SHARES]
    lines = [
        "",
        "Action-transformation error in the course of grounding, as a share of its iterations (logged states; uniform "
        "random actions / the policies' own; mean over seeds and members):",
        "",
        f"| method | samples | iterations | {' | '.join(heads)} |",
        f"|---|--:|--:|{'--:|' * len(SHARES)}",
    ]
    for method, samples in sorted(curves, key=lambda cell: _place(dict(method=cell[0], samples=cell[1]))):
        curve = curves[method, samples]
        uniform, own = (_mean(curve[name]) for name in ("error_uniform", "error_own"))
        at = [max(0, round(share * len(uniform)) - 1) for share in SHARES]
        values = " | ".join(f"{uniform[i]:.3f} / {own[i]:.3f}" for i in at)
        lines.append(f"| {method} | {samples:,} | {len(uniform):,} | {values} |")
    return lines


def _place(row: dict[str, Any]) -> tuple[int, int]:
    """Where a row stands in a table: methods in their own order, then by samples."""
    return list(METHODS).index(row["method"]), row["samples"]


def _mean(values: np.ndarray) -> np.ndarray:
    return values.reshape(len(values), -1).mean(axis=1)


def sweep_section(sweep: Sweep, images: Path, page: Path) -> str:
    """A sweep as Markdown; copies its pictures into `images`."""
    i = sweep.identity
    lines = [
        f"### {i['task']}, preset {i['preset']['name']}",
        "",
        f"`{sweep.command}`",
        "",
        f"Seeds {', '.join(map(str, range(i['seeds'])))}. {_where(sweep)}. {budgets(i)}",
        "",
        report.markdown(sweep.rows, list(METHODS), sweep.failures).rstrip(),
        "",
        *seconds_table(sweep),
        *curve_table(sweep),
    ]
    for picture in sweep.pictures:
        images.mkdir(parents=True, exist_ok=True)
        copy = images / f"{sweep.name}-{picture.name}"
        shutil.copyfile(picture, copy)
        what = {"returns": "Return in the target", "errors": "Action-transformation error"}[picture.stem]
        link = os.path.relpath(copy, page.parent).replace(os.sep, "/")
        lines += ["", f"![{what}, {i['task']}, preset {i['preset']['name']}]({link})"]
    return "\n".join(lines)


def _where(sweep: Sweep) -> str:
    """Machine, versions and commit; and which methods ran by another commit than the sweep began with."""
    versions = sweep.versions
    shown = ", ".join(f"{name} {versions[name]}" for name in ("jax", "mujoco") if name in versions)
    first = versions.get("commit", "?")
    later: dict[str, list[str]] = {}
    for row in sweep.rows:
        methods = later.setdefault(row.get("commit", first), [])
        if row["method"] not in methods:
            methods.append(row["method"])
    others = "".join(f" ({', '.join(m)}: {name})" for name, m in later.items() if name != first)
    return (
        f"{versions.get('machine', 'unknown machine')}; commit {first}{others}, "
        f"Python {versions.get('python', '?')}, {shown}"
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


def page(args: Args) -> str:
    """The whole page, whose pictures are copied beside it."""
    sweeps, benchmarks = find(args.folders)
    images = args.out.parent / "images"
    read = [read_sweep(folder) for folder in sweeps]
    records = [_read_json(folder / "benchmark.json") for folder in benchmarks]
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


if __name__ == "__main__":
    sys.exit(main())
