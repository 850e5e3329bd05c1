"""What the figures of a diagnosis share: colours, axes, bars, and files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

Array = np.ndarray
SMALL = 4.9
"""Width of a figure of which two stand beside each other."""
MEASURED, NOMINAL, CORRECTED, MODELLED = "#1b1b1b", "#c1502e", "#1f6fb2", "#2f9e5b"


def save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
    return path


def short(text: str, most: int) -> str:
    """A name from a model or a file as matplotlib shall write it: short, and never as a formula."""
    return text[:most].replace("$", r"\$")


def curves(
    measured: Array, given: Array, corrected: Array, modelled: Array | None = None
) -> list[tuple[Array, str, str, float, str]]:
    """What was measured and what either model predicts, with colour, style, width and name; the corrected model only
    where it predicts something else than the model as given.

    Args:
        modelled: what the corrected model predicts with what is left as functions, where there are any.
    """
    out = [
        (measured, MEASURED, "-", 2.2, "measured"),
        (given, NOMINAL, "--", 1.3, "model as given"),
        (corrected, CORRECTED, "-", 1.3, "corrected model"),
    ]
    shown = out[:2] if np.array_equal(given, corrected, equal_nan=True) else out
    return (
        shown
        if modelled is None
        else [*shown, (modelled, MODELLED, "-", 1.0, "with what is left as a function")]
    )


def legend_above(ax: Axes) -> None:
    """The curves' names in a line above the axes, where they hide nothing."""
    ax.legend(
        fontsize=8, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=4, frameon=False, borderaxespad=0.2
    )


def log_scale(ax: Axes) -> None:
    """A logarithmic x axis with few plain numbers, also where it spans less than a decade."""
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 100 * low else (1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())


def bars(names: list[str], before: Array, after: Array, floor: float, what: str, path: Path) -> Path:
    """Errors of either model, a pair of bars for each name."""
    figure = Figure(figsize=(SMALL, 0.5 * len(names) + 1.3), layout="constrained")
    ax = figure.subplots()
    y = np.arange(len(names))
    if np.array_equal(before, after, equal_nan=True):
        ax.barh(y, before, 0.5, color=NOMINAL, label="model as given")
    else:
        ax.barh(y - 0.2, before, 0.38, color=NOMINAL, label="model as given")
        ax.barh(y + 0.2, after, 0.38, color=CORRECTED, label="corrected model")
    ax.axvline(max(floor, 1e-9), color=MEASURED, ls=":", label="noise, all together")
    shown = np.array([*before, *after, max(floor, 1e-9)])
    # a bar has no length by itself on such a scale
    ax.set_xlim(left=0.5 * float(np.nanmin(shown[shown > 0])), right=1.3 * float(np.nanmax(shown)))
    log_scale(ax)
    ax.set_yticks(y, [short(name, 18) for name in names])
    ax.invert_yaxis()
    ax.set_xlabel(what)
    legend_above(ax)
    ax.grid(alpha=0.25, axis="x")
    return save(figure, path)
