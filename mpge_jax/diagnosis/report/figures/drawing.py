"""What the figures of a diagnosis share: colours, axes, bars, and files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

Array = np.ndarray
MEASURED, NOMINAL, CORRECTED = "#1b1b1b", "#c1502e", "#1f6fb2"


def save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
    return path


def short(text: str, most: int) -> str:
    """A name from a model or a file as matplotlib shall write it: short, and never as a formula."""
    return text[:most].replace("$", r"\$")


def log_scale(ax: Axes) -> None:
    """A logarithmic x axis with few plain numbers, also where it spans less than a decade."""
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 100 * low else (1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())


def bars(names: list[str], before: Array, after: Array, floor: float, what: str, path: Path) -> Path:
    """Errors of either model, a pair of bars for each name."""
    figure = Figure(figsize=(6.4, 0.55 * len(names) + 1.4), layout="constrained")
    ax = figure.subplots()
    y = np.arange(len(names))
    ax.barh(y - 0.2, before, 0.38, color=NOMINAL, label="model as given")
    ax.barh(y + 0.2, after, 0.38, color=CORRECTED, label="corrected model")
    ax.axvline(max(floor, 1e-9), color=MEASURED, ls=":", label="noise alone, all together")
    log_scale(ax)
    ax.set_yticks(y, [short(name, 18) for name in names])
    ax.invert_yaxis()
    ax.set_xlabel(what)
    ax.legend(fontsize=8)
    ax.grid(alpha=0.25, axis="x")
    return save(figure, path)
