"""Every column of a log over time, on one page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mpge_jax.diagnosis.inspection.overview import Overview
from mpge_jax.diagnosis.recordings.formats.tables import Column, Table

POINTS = 1500
"""Points of a line, at most: of each stretch of a longer one its least and largest number are drawn."""
PANELS, TOGETHER, ACROSS = 96, 16, 4
"""Panels on a page, parts of a column from which on they share one panel, and panels side by side."""
KNOWN, OTHER = "#1f6fb2", "#6b6b6b"


def draw(overview: Overview, path: Path) -> Path:
    """One panel a part: blue with the name of what it is read as, grey where it is not read."""
    panels = [p for table in overview.log.tables for c in table.columns for p in _panels(overview, table, c)]
    left_out, panels = len(panels) - PANELS, panels[:PANELS]
    rows = -(-len(panels) // ACROSS) or 1
    high = 1.7 * rows + 0.6
    figure = Figure(figsize=(4.0 * ACROSS, high))
    axes = figure.subplots(rows, ACROSS, squeeze=False).ravel()
    # set by hand, as a layout that is computed takes seconds
    figure.subplots_adjust(
        left=0.03, right=0.99, bottom=0.3 / high, top=1 - 0.65 / high, wspace=0.15, hspace=0.42
    )
    for ax, (title, target, time, lines) in zip(axes, panels, strict=False):
        for line in lines:
            ax.plot(
                *_thinned(time, line),
                lw=0.8,
                color=KNOWN if target else OTHER,
                alpha=1.0 if len(lines) == 1 else 0.5,
            )
        ax.set_title(_plain(title), fontsize=8, loc="left", color="#1b1b1b")
        if target:
            ax.set_title(_plain(target), fontsize=8, loc="right", color=KNOWN)
        ax.tick_params(labelsize=7)
        ax.margins(x=0)
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    over = f" ({left_out} more are not drawn)" if left_out > 0 else ""
    figure.suptitle(
        _plain(f"{overview.log.name}: every column over time in s{over}"), fontsize=10, y=1 - 0.15 / high
    )
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=100)
    return path


def _panels(
    overview: Overview, table: Table, column: Column
) -> list[tuple[str, str, np.ndarray, list[np.ndarray]]]:
    """(title, what it is read as, time, lines) of each panel of a column."""
    time = np.arange(table.rows, dtype=float) if table.time is None else table.time - table.time[0]
    found = overview.found
    targets = {part: target for target, (c, part) in found.items() if c is column}
    n = column.values.shape[1]
    if n > TOGETHER and not targets:
        return [(f"{column.title} ({n} parts)", "", time, list(column.values.T))]
    return [(_title(column, i), targets.get(i, ""), time, [column.values[:, i]]) for i in range(n)]


def _title(column: Column, part: int) -> str:
    if column.titles is not None:
        return column.titles[part]
    if column.values.shape[1] == 1:
        return column.title
    return f"{column.title} {column.parts[part] if column.parts else f'[{part}]'}"


def _thinned(time: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest number of each stretch, in the order of time, so that spikes stay."""
    known = np.isfinite(value) & np.isfinite(time)
    time, value = time[known], value[known]
    if time.size <= 2 * POINTS:
        return time, value
    edges = np.linspace(0, time.size, POINTS + 1).astype(int)[:-1]
    ends = np.append(edges[1:], time.size)
    rows = np.array(
        [[a + value[a:b].argmin(), a + value[a:b].argmax()] for a, b in zip(edges, ends, strict=True)]
    )
    rows = np.sort(rows, axis=1).ravel()
    return time[rows], value[rows]


def _plain(text: str) -> str:
    """A name from a file as matplotlib shall write it: short, and never as a formula."""
    return (text if len(text) < 60 else f"{text[:28]} ... {text[-28:]}").replace("$", r"\$")
