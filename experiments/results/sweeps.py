"""A sweep on the page of results: its command, its numbers, its pictures."""

import json
import os
import re
import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import envs
from experiments import report
from experiments.methods import METHODS
from mpge_jax.loop import Curve

PICTURES = {
    "returns": "Return in the target",
    "errors": "Action-transformation error",
    "heat_map": "Action-transformation error along each rollout policy",
}
SHARES = (0.05, 0.1, 0.25, 0.5, 1.0)


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
      along_policies: errors of its transformers along every rollout policy (`heat_map`), where they were measured.
    """

    name: str
    identity: dict[str, Any]
    versions: dict[str, str]
    rows: list[dict[str, Any]]
    curves: dict[tuple[str, int], Curve]
    failures: dict[str, str]
    pictures: list[Path]
    along_policies: dict[str, Any] | None = None

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


def read_json(path: Path) -> Any:
    """The content of a file.

    Raises:
      ValueError: it cannot be read; says which.
    """
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read ({type(error).__name__}: {error})") from error


def read_sweep(folder: Path) -> Sweep:
    """Reads a sweep's folder.

    Raises:
      ValueError: a file of it is damaged; says which.
    """
    record = read_json(folder / "results.json")
    curves = {}
    for file in sorted((folder / "cells").glob("*/curve.npz")):
        method, samples = file.parent.name.rsplit("-", 1)
        try:
            with np.load(file, allow_pickle=False) as arrays:
                curves[method, int(samples)] = {name: arrays[name] for name in arrays.files}
        except Exception as error:
            raise ValueError(f"{file} is damaged ({type(error).__name__}: {error})") from error
    failures = {
        file.parent.name: _summary(read_json(file)["error"])
        for file in sorted((folder / "cells").glob("*/error.json"))
        if not (file.parent / "result.json").exists()
    }
    heat_map = folder / "heat_map.json"
    along = read_json(heat_map) if heat_map.is_file() else None
    if along is not None and not {"cells", "steps", "versions"} <= set(along):
        raise ValueError(f"{heat_map} is not what heat_map writes; run it again")
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
            pictures=[folder / f"{name}.png" for name in PICTURES if (folder / f"{name}.png").is_file()],
            along_policies=along,
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
    for row in sorted(sweep.rows, key=lambda row: order((row["method"], row["samples"]))):
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
    for method, samples in sorted(curves, key=order):
        curve = curves[method, samples]
        uniform, own = (_mean(curve[name]) for name in ("error_uniform", "error_own"))
        at = [max(0, round(share * len(uniform)) - 1) for share in SHARES]
        values = " | ".join(f"{uniform[i]:.3f} / {own[i]:.3f}" for i in at)
        lines.append(f"| {method} | {samples:,} | {len(uniform):,} | {values} |")
    return lines


def policies_table(sweep: Sweep) -> list[str]:
    """Each cell's mean error along every rollout policy, where it was measured."""
    record = sweep.along_policies
    if record is None:
        return []
    cells = {name: np.array(value) for name, value in record["cells"].items()}
    size = next(iter(cells.values())).shape[2]
    alone = "; seed i of SPG recorded with policy i alone" if any(n.startswith("SPG") for n in cells) else ""
    lines = [
        "",
        f"Action-transformation error along {record['steps']:,} steps of each rollout policy in the grounded "
        f"simulator, mean over seeds and transformers{alone} (`python -m experiments.results.heat_map "
        f"results/{sweep.name}`, where the sweep left its transformers; commit {record['versions']['commit']}):",
        "",
        f"| cell | {' | '.join(f'policy {k}' for k in range(size))} | least and most of one transformer |",
        f"|---|{'--:|' * (size + 1)}",
    ]
    for name, c in cells.items():
        means = " | ".join(f"{x:.3f}" for x in c.mean(axis=(0, 1)))
        lines.append(f"| {name} | {means} | {c.min():.3f}, {c.max():.3f} |")
    return lines


def order(cell: tuple[str, int]) -> tuple[int, int]:
    """Where a method and its samples stand in a table: methods in their own order, then by samples."""
    method, samples = cell
    return list(METHODS).index(method), samples


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
        *policies_table(sweep),
    ]
    for picture in sweep.pictures:
        images.mkdir(parents=True, exist_ok=True)
        copy = images / f"{sweep.name}-{picture.name}"
        shutil.copyfile(picture, copy)
        lines += [
            "",
            image(f"{PICTURES[picture.stem]}, {i['task']}, preset {i['preset']['name']}", copy, page),
        ]
    return "\n".join(lines)


def image(what: str, picture: Path, page: Path) -> str:
    """A picture on a page, as Markdown."""
    return f"![{what}]({os.path.relpath(picture, page.parent).replace(os.sep, '/')})"


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
