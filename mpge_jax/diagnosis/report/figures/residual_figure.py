"""What is left as a function: its curve over its inputs, and the force that held-out recordings show to be missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from mpge_jax.diagnosis.effects.context import Context, joint_unit
from mpge_jax.diagnosis.effects.residual.axis import ANGLE, DRIVE, LOAD, SPEED, TURNED, WITHIN_TURN, Axis
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.report.figures import drawing
from mpge_jax.diagnosis.report.figures.drawing import CORRECTED, MEASURED
from mpge_jax.diagnosis.report.figures.motion_figures import span
from mpge_jax.diagnosis.residual.model import Function
from mpge_jax.diagnosis.residual.points import Points, missing_in_forces, missing_in_motion
from mpge_jax.diagnosis.verdict.result import Result

Array = np.ndarray
FUNCTIONS, GRID = 4, 360
"""Functions that are shown at most, and values of every input by which they are drawn."""
SHORT = {
    WITHIN_TURN: "angle within",
    ANGLE: "position",
    SPEED: "speed",
    DRIVE: "force of the drives",
    LOAD: "load",
    TURNED: "travel since it turned",
}
POINTS = "missing in held-out recordings"


def residual(d: Result, functions: tuple[Function, ...], path: Path) -> Path:
    """The figure: a row for every function."""
    shown = functions[:FUNCTIONS]
    figure = Figure(figsize=(9.6, 3.1 * len(shown)), layout="constrained")
    rows = figure.subfigures(len(shown), 1, squeeze=False)[:, 0]
    for row, function in zip(rows, shown, strict=True):
        if isinstance(d.held, ForceErrors):
            points = missing_in_forces(d.prepared, d.fit, d.held, function)
        else:
            points = missing_in_motion(d.prepared, d.fit, function)
        if len(function.axes) == 1:
            _curve(d.ctx, function, points, row.subplots())
        else:
            _map(d.ctx, function, points, row)
    return drawing.save(figure, path)


def _curve(ctx: Context, function: Function, points: Points, ax: Axes) -> None:
    """A function of one input."""
    (axis,), effect = function.axes, function.effect
    x = np.linspace(axis.low, axis.high, GRID)
    y = effect.value(np, function.theta, [x])
    ax.plot(
        _drawn(axis, points.inputs[0]),
        points.force,
        "o",
        ms=3,
        color=MEASURED,
        alpha=0.55,
        mew=0,
        label=POINTS,
    )
    ax.plot(x, y, color=CORRECTED, lw=2.0, label="function")
    ax.set_ylim(*span(y, (points.force,), 0.0))
    ax.set_xlabel(_named(ctx, function, axis))
    ax.set_ylabel(_force(ctx, function))
    ax.grid(alpha=0.25)
    drawing.legend_above(ax)


def _map(ctx: Context, function: Function, points: Points, row: SubFigure) -> None:
    """A function of two inputs as colour, and beside it the points over what it says there."""
    effect, (first, second) = function.effect, function.axes
    left, right = row.subplots(1, 2, width_ratios=(3, 2))
    x, y = (np.linspace(a.low, a.high, GRID) for a in (first, second))
    drawn_at = [_drawn(a, v) for v, a in zip(points.inputs, function.axes, strict=True)]
    here = [a.within(v) for v, a in zip(points.inputs, function.axes, strict=True)]
    said = effect.value(np, function.theta, here)
    shade = effect.value(np, function.theta, list(np.meshgrid(x, y)))
    # by what was seen: in corners where nothing was, a function of splines may be anything
    seen = np.array([*said, *points.force]) if points.force.size else shade
    most = max(float(np.quantile(np.abs(seen), 0.98)), 1e-12)
    colour = {"cmap": "RdBu_r", "vmin": -most, "vmax": most}
    drawn = left.pcolormesh(x, y, shade, shading="nearest", rasterized=True, **colour)
    left.scatter(*drawn_at, c=points.force, s=16, edgecolors=MEASURED, linewidths=0.5, label=POINTS, **colour)
    left.set_xlim(first.low, first.high)
    left.set_ylim(second.low, second.high)
    left.set_xlabel(_named(ctx, function, first))
    left.set_ylabel(_named(ctx, function, second))
    drawing.legend_above(left)
    row.colorbar(drawn, ax=left, label=f"missing at {_force(ctx, function)}", extend="both")
    right.axline((0, 0), slope=1, color=CORRECTED, lw=1.5)
    right.plot(said, points.force, "o", ms=3, color=MEASURED, alpha=0.55, mew=0)
    right.set_xlabel("as the function says")
    right.set_ylabel(POINTS)
    right.set_ylim(*span(np.append(said, 0.0), (points.force,), 0.0))
    right.grid(alpha=0.25)


def _drawn(axis: Axis, x: Array) -> Array:
    """Where values [N] stand along an axis."""
    return axis.within(x) if axis.around else x


def _force(ctx: Context, function: Function) -> str:
    unit = joint_unit(ctx, function.term.place, "N m", "N")
    what = "friction of " if function.effect.dry else ""
    return f"{what}{drawing.short(function.term.place.name, 18)} ({unit})"


def _named(ctx: Context, function: Function, axis: Axis) -> str:
    whose = f" of {drawing.short(axis.joint, 18)}" if axis.joint else f" {axis.part}" if axis.around else ""
    return f"{SHORT[axis.input]}{whose} ({axis.unit(ctx, function.term.place)})"
