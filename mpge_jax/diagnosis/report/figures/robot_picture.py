"""The robot with the places of effects marked: rendered by MuJoCo, or drawn as a kinematic tree where that fails."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mpge_jax.diagnosis.machine.model import names_of
from mpge_jax.diagnosis.report.figures.marks import Mark, Spot, find
from mpge_jax.diagnosis.report.figures.robot_render import Picture, render

Array = np.ndarray
_MARK = "#d62718"
_LONG = [int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER)]


def robot(spec: mujoco.MjSpec, model: mujoco.MjModel, qpos: Array, marks: Sequence[Mark], path: Path) -> Path:
    """Show the machine in the pose of the middle of a recording.

    Args:
        spec: the description that is rendered. model: compiled from it, with the same joints and bodies.
        qpos: [T, nq]. marks: places to show.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos[len(qpos) // 2]
    mujoco.mj_forward(model, data)
    found = [(mark, find(model, data, mark)) for mark in marks]
    spots = [(mark, spot) for mark, spot in found if spot is not None]
    everywhere = [mark.label.replace("\n", " ") for mark, spot in found if spot is None]
    picture = render(
        spec,
        data.qpos,
        np.array([spot.point for _, spot in spots]).reshape(-1, 3),
        np.array([spot.along for _, spot in spots]).reshape(-1, 3),
        [body for _, spot in spots for body in spot.bodies],
        [geom for _, spot in spots for geom in spot.geoms],
    )
    figure = _photograph(picture, spots) if picture is not None else _tree(model, data, spots)
    if everywhere:
        text = "on the whole machine: " + ", ".join(everywhere)
        figure.axes[0].text(0.02, 0.98, text, color=_MARK, transform=figure.axes[0].transAxes, va="top")
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110 if picture is None else 180)
    return path


def _photograph(picture: Picture, spots: list[tuple[Mark, Spot]]) -> Figure:
    """The picture with a ring around every spot; the labels stand in a margin at the right."""
    height, width = picture.pixels.shape[:2]
    margin = 0.42 * width if spots else 0.0
    figure = Figure(figsize=(4.2 * (width + margin) / width, 4.2 * height / width))
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.imshow(picture.pixels)
    ax.axis("off")
    ax.set_xlim(0, width + margin)
    ax.set_ylim(height, 0)
    labels: dict[tuple[float, float], list[str]] = {}
    for (mark, _), (x, y) in zip(spots, picture.points, strict=True):
        lines = labels.setdefault((float(x), float(y)), [])
        lines += [line for line in mark.label.split("\n") if line not in lines]
    order = sorted(labels, key=lambda point: point[1])
    need = [0.055 * height * (len(labels[point]) + 1) for point in order]
    squeeze = min(1.0, 0.96 * height / max(sum(need), 1e-9))
    taken = 0.02 * height
    for i, (point, size) in enumerate(zip(order, need, strict=True)):
        latest = 0.98 * height - squeeze * sum(need[i:])
        taken = max(taken, min(point[1] - 0.5 * size, latest))
        _label(
            ax, point, "\n".join(labels[point]), (1.02 * width, taken + 0.5 * squeeze * size), 10 * squeeze
        )
        taken += squeeze * size
    return figure


def _label(ax: Axes, point: tuple[float, float], text: str, at: tuple[float, float], size: float) -> None:
    ax.plot(*point, "o", ms=20, mfc="none", mec="white", mew=4.0, zorder=3)
    ax.plot(*point, "o", ms=20, mfc="none", mec=_MARK, mew=2.2, zorder=4)
    ax.annotate(
        text, point, at, color=_MARK, ha="left", va="center", zorder=5, fontsize=size,
        bbox={"fc": "white", "ec": _MARK, "boxstyle": "round,pad=0.3"},
        arrowprops={"arrowstyle": "-", "color": _MARK, "shrinkB": 10},
    )  # fmt: skip


def _segments(model: mujoco.MjModel, data: mujoco.MjData) -> list[tuple[Array, Array]]:
    """Line segments that show the bodies: parent to child, and body to centre of mass."""
    out = []
    for b in range(1, model.nbody):
        anchor = data.xpos[b]
        if model.body_jntnum[b]:
            anchor = data.xanchor[model.body_jntadr[b]]
        parent = int(model.body_parentid[b])
        if parent:
            start = (
                data.xanchor[model.body_jntadr[parent]] if model.body_jntnum[parent] else data.xpos[parent]
            )
            out.append((start, anchor))
        first, count = int(model.body_geomadr[b]), int(model.body_geomnum[b])
        for g in range(first, first + count) if count else ():
            if model.geom_type[g] in _LONG:
                axis = data.geom_xmat[g].reshape(3, 3)[:, 2] * model.geom_size[g, 1]
                out.append((data.geom_xpos[g] - axis, data.geom_xpos[g] + axis))
            else:
                out.append((anchor, data.geom_xpos[g]))
        if not count:
            out.append((anchor, data.xipos[b]))
    return out


def _tree(model: mujoco.MjModel, data: mujoco.MjData, spots: list[tuple[Mark, Spot]]) -> Figure:
    """The kinematic tree, seen along the axis in which it is thinnest."""
    lines = _segments(model, data)
    cloud = np.array([p for line in lines for p in line] or [np.zeros(3)])
    span = np.ptp(cloud, axis=0)
    horizontal = 0 if span[0] >= span[1] else 1
    view = [horizontal, 2] if span[2] > 0.02 * span.max() else [0, 1]
    figure = Figure(figsize=(5.2, 4.4), layout="constrained")
    ax = figure.subplots()
    for a, b in lines:
        ax.plot(*np.array([a, b])[:, view].T, color="#8fa3b5", lw=6, solid_capstyle="round", zorder=1)
    names = names_of(model)
    for j in range(model.njnt):
        x, y = data.xanchor[j][view]
        ax.plot(x, y, "o", color="#33424f", ms=5, zorder=2)
        if model.njnt <= 12:
            ax.annotate(
                names.joints[j][:16].replace("$", r"\$"),
                (x, y),
                xytext=(7, 5),
                textcoords="offset points",
                fontsize=8,
            )
    for mark, spot in spots:
        x, y = spot.point[view]
        ax.plot(x, y, "o", ms=24, mfc="none", mec=_MARK, mew=2.6, zorder=3)
        ax.annotate(mark.label, (x, y), xytext=(14, -16), textcoords="offset points", color=_MARK, va="top")
    pad = 0.15 * max(float(span.max()), 0.05)
    centre, half = 0.5 * (cloud.max(0) + cloud.min(0)), 0.5 * float(span.max()) + pad
    ax.set_xlim(centre[view[0]] - half, centre[view[0]] + half)
    ax.set_ylim(centre[view[1]] - half, centre[view[1]] + half)
    ax.set_aspect("equal")
    ax.set_xlabel(f"{'xyz'[view[0]]} (m)")
    ax.set_ylabel(f"{'xyz'[view[1]]} (m)")
    ax.grid(alpha=0.25)
    return figure
