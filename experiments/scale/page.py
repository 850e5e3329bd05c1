"""docs/scale.md: the text of page.md with the numbers that were measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from experiments.presets import PRESETS
from experiments.runners.options import AHEAD, ARRAY
from experiments.scale.cost_model import FULL, CostModel, fitted
from experiments.scale.costs import CellCost, Comparison, Diagnosis, Jobs, read
from mpge_jax.diagnosis.recordings.states import MAX_ROWS

ROBOTS, RUNS, CORES = 10_000, 1_000, 1_000
TEXT = Path(__file__).with_name("page.md")


def markdown(kept: Path) -> str:
    """The page.

    Args:
      kept: folder of the measurements.

    Raises:
      FileNotFoundError: no diagnosis was measured.
    """
    diagnoses, jobs, comparisons = read(Diagnosis, kept), read(Jobs, kept), read(Comparison, kept)
    if not diagnoses:
        raise FileNotFoundError(
            f"nothing was measured yet in {kept}: python -m experiments.scale --help says how"
        )
    model, largest = fitted(diagnoses), max(diagnoses, key=lambda r: r.runs)
    least = min(diagnoses, key=lambda r: r.peak_mb)
    return Template(TEXT.read_text("utf-8")).substitute(
        diagnosis_machine=_machines(diagnoses),
        diagnoses=_diagnoses(diagnoses),
        search="; ".join(f"{joints}: {seconds:.0f}" for joints, seconds in model.search.items()),
        full=f"{FULL:,}",
        per_row=f"{model.per_row:.1e}",
        bytes_per_row=f"{1e6 * model.mb_per_row:,.0f}",
        max_rows=f"{MAX_ROWS:,}",
        cells=_cells(read(CellCost, kept)),
        robots=f"{ROBOTS:,}",
        runs=f"{RUNS:,}",
        cores=f"{CORES:,}",
        rows_a_run=f"{largest.rows / largest.runs:.0f}",
        checked=_checked(diagnoses),
        projection=_projection(diagnoses, model),
        jobs_machine=_machines(jobs),
        jobs=_jobs(jobs),
        ahead=f"{AHEAD:,}",
        array=f"{ARRAY:,}",
        files_in=f"{ROBOTS * RUNS:,}",
        files_out=f"{ROBOTS * least.files:,}",
        least_mb=f"{least.peak_mb:.0f}",
        comparison=_comparison(comparisons),
    )


def table(head: Iterable[str], rows: Iterable[Iterable[Any]], indent: str = "") -> str:
    """A Markdown table, with the line break behind it."""
    names = list(head)
    lines = [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    return "".join(
        f"{indent}{line}\n" for line in [*lines, *(f"| {' | '.join(map(str, r))} |" for r in rows)]
    )


def _machines(rows: Iterable[Any]) -> str:
    return "; ".join(sorted({row.machine for row in rows}))


def _diagnoses(rows: list[Diagnosis]) -> str:
    head = (
        "joints",
        "runs",
        "rows",
        "effects named",
        "CPU s",
        "s by the clock",
        "peak memory, MB",
        "it left",
    )
    cells = [
        (
            r.joints,
            f"{r.runs:,}",
            f"{r.rows:,}",
            r.effects,
            f"{r.cpu_seconds:.0f}",
            f"{r.seconds:.0f}",
            f"{r.peak_mb:.0f}",
            f"{r.files} files, {r.bytes_left / 1e6:.1f} MB",
        )
        for r in rows
    ]
    return table(head, cells)


def _cells(rows: list[CellCost]) -> str:
    if not rows:
        return ""
    measured = ("s by the clock a seed", "CPU s a seed", "peak memory, MB")
    head = ("preset", "target", "method", "samples", "seeds", *measured)

    def known(value: float, text: Callable[[float], str] = "{:.0f}".format) -> str:
        return "-" if np.isnan(value) else text(value)

    cells = [
        (
            r.preset,
            r.task,
            r.method,
            r.samples or "-",
            r.seeds,
            known(r.seconds / r.seeds),
            known(r.cpu_seconds / r.seeds),
            known(r.peak_mb),
        )
        for r in rows
    ]
    steps = {
        name: {t: s.grounding.iterations * s.grounding.simulator_steps for t, s in preset.tasks.items()}
        for name, preset in PRESETS.items()
    }
    longer = ", ".join(f"{t} {steps['paper'][t] / count:.0f} times" for t, count in steps["standard"].items())
    return (
        "\n## What a cell costs\n\nFrom folders that sweeps left (`python -m experiments.scale sweep FOLDER`; "
        f"{_machines(rows)}).\nA dash: from before CPU time and memory were kept.\n\n{table(head, cells)}\n"
        "`paper` and `release` were not run. For them, grounding takes more steps of the simulator than in `standard`\n"
        f"(`paper`: {longer}), in one simulator at a time.\n"
    )


def _projection(rows: list[Diagnosis], model: CostModel) -> str:
    largest = max(rows, key=lambda r: r.runs)
    count = round(RUNS * largest.rows / largest.runs)
    stored = largest.bytes / largest.rows / largest.joints
    head = (
        "joints",
        "CPU hours",
        "of them for the data",
        f"hours on {CORES:,} cores",
        "recordings, GB",
        "results, GB",
    )
    cells = []
    for joints in model.search:
        hours = ROBOTS * model.cpu_seconds(joints, count) / 3600
        data = ROBOTS * model.per_row * joints * count / 3600
        left = float(np.mean([r.bytes_left for r in rows if r.joints == joints]))
        recorded = ROBOTS * count * joints * stored / 1e9
        cells.append(
            (
                joints,
                f"{hours:,.0f}",
                f"{data:,.0f}",
                f"{hours / CORES:.2g}",
                f"{recorded:,.0f}",
                f"{ROBOTS * left / 1e9:.0f}",
            )
        )
    return table(head, cells)


def _checked(rows: list[Diagnosis]) -> str:
    """Which of it was measured as it is."""
    found = sorted({r.joints for r in rows if r.runs >= RUNS})
    several = "s" if found and found[-1] > 1 else ""
    return (
        f" ({RUNS:,} runs were measured with {' and '.join(map(str, found))} joint{several})" if found else ""
    )


def _jobs(rows: list[Jobs]) -> str:
    head = ("runner", "jobs", "load", "s", "ms a job")
    cells = [
        (
            j.runner + (f", {j.workers} process{'es' if j.workers > 1 else ''}" if j.workers else ""),
            f"{j.jobs:,}",
            f"{j.load:.0f}",
            f"{j.seconds:.1f}",
            f"{1e3 * j.seconds / j.jobs:,.0f}",
        )
        for j in rows
    ]
    return table(head, cells, "  ")


def _comparison(rows: list[Comparison]) -> str:
    if not rows:
        return ""
    largest = max(rows, key=lambda c: c.robots)
    return (
        f" The comparison reads every `diagnosis.json`\n  into one process: {largest.robots:,} robots with "
        f"{largest.effects} effects each took {largest.seconds:.0f} s ({largest.cpu_seconds:.0f} CPU s) and "
        f"{largest.peak_mb:.0f} MB\n  (`python -m experiments.scale comparison --robots {largest.robots}`)."
    )
