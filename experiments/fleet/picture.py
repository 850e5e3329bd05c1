"""Every robot's estimates beside what the fleet shares."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.fleet.comparison import Effect, Fleet, Parameter, named
from mpge_jax.diagnosis.estimation.covariance import WITHIN
from mpge_jax.diagnosis.report.figures.drawing import CORRECTED, MEASURED, NOMINAL, save, short

PANELS, ROBOTS = 6, 30
"""Parameters, and robots of each, that are drawn at most: those with odd robots, and odd robots, first."""


def draw(fleet: Fleet, path: Path) -> Path | None:
    """Draws a panel for each shared parameter; None, and no file, where there is none."""
    panels = [(e, p) for e in fleet.effects if e.shared for p in e.parameters if p.pooled is not None]
    panels.sort(key=lambda panel: -len(panel[1].odd))
    panels = panels[:PANELS]
    if not panels:
        return None
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    shown = [_robots(parameter) for _, parameter in panels]
    height = 0.2 * max(map(len, shown)) + 1.5
    figure = Figure(figsize=(4.2 * columns, height * rows), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axis, (effect, parameter), robots in zip(axes, panels, shown, strict=False):
        _panel(axis, effect, parameter, robots)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    axes[0].legend(fontsize=7, loc="best")
    return save(figure, path)


def _robots(p: Parameter) -> list[str]:
    """Those that stand out, farthest first; of the others as many as there is room for, evenly over their values."""
    odd = sorted(p.odd, key=lambda robot: -abs(p.odd[robot]))[:ROBOTS]
    rest = sorted((r for r in p.estimates if r not in p.odd), key=lambda r: (p.estimates[r].value, r))
    room = min(ROBOTS - len(odd), len(rest))
    return odd + [rest[i] for i in np.unique(np.linspace(0, len(rest) - 1, room).astype(int))]


def _panel(axis: Axes, effect: Effect, p: Parameter, robots: list[str]) -> None:
    assert p.pooled is not None
    middle, spread = p.pooled.value, WITHIN * p.pooled.spread
    axis.axvspan(middle - spread, middle + spread, color=CORRECTED, alpha=0.12, label="95 % of the robots")
    axis.axvline(middle, color=CORRECTED, lw=1, label="shared value")
    for odd, colour, label in ((False, MEASURED, "a robot, 95 %"), (True, NOMINAL, "stands out")):
        rows = [i for i, robot in enumerate(robots) if (robot in p.odd) == odd]
        if rows:
            found = [p.estimates[robots[i]] for i in rows]
            # An estimate without an interval is a point.
            half = [WITHIN * e.error if e.error > 0 else 0.0 for e in found]
            style: dict[str, Any] = {"fmt": "o", "ms": 3, "lw": 1, "color": colour, "label": label}
            axis.errorbar([e.value for e in found], rows, xerr=half, **style)
    axis.set_yticks(range(len(robots)), [short(robot, 18) for robot in robots], fontsize=7)
    axis.invert_yaxis()
    axis.set_title(short(named(effect.key), 44), fontsize=9)
    left = len(p.estimates) - len(robots)
    more = f"; {left} more robots" if left else ""
    axis.set_xlabel(short(f"{p.name} ({p.unit}){more}", 60), fontsize=8)
    axis.tick_params(axis="x", labelsize=7)
    axis.grid(alpha=0.25, axis="x")
