"""A sweep on the page of results: its command, its numbers, its pictures."""

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

import envs
from experiments import report
from experiments.methods import METHODS
from experiments.results.sweeps import PICTURES, Sweep, order

SHARES = (0.05, 0.1, 0.25, 0.5, 1.0)
"""Of the iterations of grounding, after which errors are shown."""


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
        f"{_cell(method, samples)} {whole:.1f}"
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


def returns_table(sweep: Sweep) -> list[str]:
    """Returns of each cell's agents in the simulator that they were trained in, where they were measured."""
    record = sweep.grounded_returns
    if record is None:
        return []
    known = all("error" in found for found in record["cells"].values())
    lines = [
        "",
        f"What the same agents return in the simulator as it is and in the grounded one that they were trained in, "
        f"stochastic, mean ± standard deviation over seeds, {record['episodes']} episodes each"
        + (", and the action-transformation error where they go" if known else "")
        + f" (`python -m experiments.results.grounded_returns results/{sweep.name}`, where the sweep left its agents; "
        f"commit {record['versions']['commit']}). More in the grounded simulator than in the target was learned from "
        "what is wrong there:",
        "",
        f"| cell | simulator | grounded | target |{' error |' if known else ''}",
        f"|---|--:|--:|--:|{'--:|' if known else ''}",
    ]
    for name, found in record["cells"].items():
        rows = [row for row in sweep.rows if f"{row['method']}-{row['samples']}" == name]
        told = [
            report.spread(values)
            for values in (found["simulator"], found["grounded"], [row["return_stochastic"] for row in rows])
        ]
        told += [report.spread(found["error"], 3)] if known else []
        lines.append(f"| {name} | {' | '.join(told)} |")
    return lines


def _mean(values: np.ndarray) -> np.ndarray:
    return values.reshape(len(values), -1).mean(axis=1)


def sweep_section(sweep: Sweep, images: Path, page: Path) -> str:
    """A sweep as Markdown; its pictures go into `images`: that of its returns is drawn of its rows, which may have come
    from several runs."""
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
        *returns_table(sweep),
    ]
    images.mkdir(parents=True, exist_ok=True)
    drawn = images / f"{sweep.name}-returns.png"
    report.returns_figure(sweep.rows, drawn, i["task"])
    shown = [("Return in the target", drawn)]
    for picture in sweep.pictures:
        copy = images / f"{sweep.name}-{picture.name}"
        shutil.copyfile(picture, copy)
        shown.append((PICTURES[picture.stem], copy))
    for what, path in shown:
        lines += ["", image(f"{what}, {i['task']}, preset {i['preset']['name']}", path, page)]
    return "\n".join(lines)


def image(what: str, picture: Path, page: Path) -> str:
    """A picture on a page, as Markdown."""
    return f"![{what}]({os.path.relpath(picture, page.parent).replace(os.sep, '/')})"


def _where(sweep: Sweep) -> str:
    """Machine, versions and commit; and which cells are of another machine or commit than the sweep began with."""
    versions = sweep.versions
    shown = ", ".join(f"{name} {versions[name]}" for name in ("jax", "mujoco") if name in versions)
    return (
        f"{_since(sweep, 'machine', 'unknown machine')}; commit {_since(sweep, 'commit', '?')}, "
        f"Python {versions.get('python', '?')}, {shown}"
    )


def _cell(method: str, samples: int) -> str:
    return f"{method} at {samples:,}" if samples else method


def _since(sweep: Sweep, name: str, unknown: str) -> str:
    """A version that the sweep began with, and the cells that have another."""
    first = sweep.versions.get(name, unknown)
    others: dict[str, list[str]] = {}
    for row in sweep.rows:
        cells = others.setdefault(row.get(name, first), [])
        cell = _cell(row["method"], row["samples"])
        if cell not in cells:
            cells.append(cell)
    return first + "".join(f" ({', '.join(c)}: {value})" for value, c in others.items() if value != first)
