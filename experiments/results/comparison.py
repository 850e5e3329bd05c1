"""Methods against each other and against the paper: how far each carries a policy from `direct` to `target`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from experiments import paper
from experiments.report import save_figure
from experiments.results.sweeps import order

Rows = list[dict[str, Any]]

DRAWS = 10_000
NEAR = 0.01
"""Share of the draws in which `target` may be no better than `direct`."""
BOUNDS = ("direct", "target")
SHOWN = (500, 1_000, 5_000, 10_000)
"""Numbers of samples that the paper's tables and ours have in common."""


@dataclass(frozen=True)
class Share:
    """(return - direct) / (target - direct) of a method, and its 95 % interval by resampled seeds (None of one)."""

    method: str
    samples: int
    value: float
    interval: tuple[float, float] | None

    @property
    def told(self) -> str:
        """In words: `0.87 (0.71 to 0.98)`."""
        ends = "" if self.interval is None else f" ({self.interval[0]:.2f} to {self.interval[1]:.2f})"
        return f"{self.value:.2f}{ends}"


Shares = dict[str, list[Share]]


def returns(rows: Rows, method: str, samples: int | None = None) -> np.ndarray:
    """Stochastic returns [S] of a method's seeds."""
    found = [
        row["return_stochastic"]
        for row in rows
        if row["method"] == method and (samples is None or row["samples"] == samples)
    ]
    return np.array(found, dtype=float)


def shares(rows: Rows) -> list[Share]:
    """Of every cell of a sweep but the bounds; empty where a bound is missing or `target` is no better than `direct`.

    The seeds of the method and of either bound are drawn anew, each with replacement (percentile bootstrap).
    """
    low, high = (returns(rows, name) for name in BOUNDS)
    if not low.size or not high.size or high.mean() <= low.mean():
        return []
    cells = sorted(
        {(row["method"], row["samples"]) for row in rows if row["method"] not in BOUNDS}, key=order
    )
    out = []
    for method, samples in cells:
        own = returns(rows, method, samples)
        value = float((own.mean() - low.mean()) / (high.mean() - low.mean()))
        out.append(Share(method, samples, value, _interval(own, low, high)))
    return out


def _interval(own: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[float, float] | None:
    """None of one seed, and where the bounds are so near that resampled ones change places."""
    if min(own.size, low.size, high.size) < 2:
        return None
    rng = np.random.default_rng(0)
    a, b, c = (rng.choice(x, (DRAWS, x.size)).mean(axis=1) for x in (own, low, high))
    if (c <= b).mean() > NEAR:
        return None
    drawn = ((a - b) / (c - b))[c > b]
    return float(np.quantile(drawn, 0.025)), float(np.quantile(drawn, 0.975))


def shares_by_task(by_task: dict[str, Rows]) -> Shares:
    """Of the tasks whose sweeps have both bounds."""
    return {task: found for task, rows in by_task.items() if (found := shares(rows))}


def shares_table(found: Shares) -> list[str]:
    """Markdown: methods down, tasks across; empty where no sweep has both bounds."""
    if not found:
        return []
    by_cell = [{(s.method, s.samples): s for s in each} for each in found.values()]
    lines = [
        "How far each method comes from `direct` (0) to `target` (1), (return - direct) / (target - direct), with the "
        f"95 % percentile interval of {DRAWS:,} bootstrap samples (seeds of the method, of `direct` and of `target` "
        "drawn anew). Of three seeds such an interval is too narrow; `target` had no more than the preset's budget, so "
        "that 1 can be passed. `-`: not run.",
        "",
        f"| method | samples | {' | '.join(found)} |",
        f"|---|--:|{'--:|' * len(found)}",
    ]
    for cell in sorted(set().union(*by_cell), key=order):
        told = " | ".join(cells[cell].told if cell in cells else "-" for cells in by_cell)
        lines.append(f"| {cell[0]} | {f'{cell[1]:,}' if cell[1] else '-'} | {told} |")
    return lines


def shares_figure(found: Shares, path: Path) -> bool:
    """The same as a picture, a panel for each task; whether there was anything to draw."""
    if not found:
        return False
    names = sorted({(s.method, s.samples) for each in found.values() for s in each}, key=order, reverse=True)
    figure, panels = plt.subplots(
        1,
        len(found),
        figsize=(2.0 + 2.8 * len(found), 1.2 + 0.27 * len(names)),
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    for axes, (task, each) in zip(panels[0], found.items(), strict=True):
        for s in each:
            y = names.index((s.method, s.samples))
            if s.interval is not None:
                axes.plot(s.interval, [y, y], color="#0072B2", lw=2, alpha=0.5)
            axes.plot(s.value, y, "o", color="#0072B2")
        for bound, style in ((0.0, ":"), (1.0, "--")):
            axes.axvline(bound, color="black", lw=1, linestyle=style)
        axes.set(title=task, xlabel="direct 0, target 1")
        axes.grid(axis="y", alpha=0.3)
    labels = [f"{method}, {samples:,}" if samples else method for method, samples in names]
    panels[0][0].set_yticks(range(len(names)), labels)
    save_figure(figure, path)
    return True


def paper_tables(by_task: dict[str, Rows]) -> list[str]:
    """The paper's tables of returns with ours beside, of the tasks that were run; `-` where a cell was not."""
    lines: list[str] = []
    for task in (task for task in paper.TASKS if task in by_task):
        rows = by_task[task]
        bounds = ", ".join(f"`{name}` {_beside(rows, task, name, 0)}" for name in BOUNDS)
        lines += [
            f"**{task}**, ours / the paper's: {bounds}.",
            "",
            f"| samples | {' | '.join(paper.METHODS)} |",
            f"|--:|{'--:|' * len(paper.METHODS)}",
        ]
        for samples in SHOWN:
            cells = [_beside(rows, task, method, samples) for method in paper.METHODS]
            lines.append(f"| {samples:,} | {' | '.join(cells)} |")
        lines.append("")
    missing = [task for task in paper.TASKS if task not in by_task]
    lines += [f"Not run: {', '.join(missing)}."] if missing and lines else []
    return lines


def _beside(rows: Rows, task: str, method: str, samples: int) -> str:
    ours, published = returns(rows, method, samples), paper.mean_return(task, method, samples)
    assert published is not None
    return f"{f'{ours.mean():.0f}' if ours.size else '-'} / {published:.0f}"
