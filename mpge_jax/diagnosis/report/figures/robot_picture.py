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
SIZE = 4.2
"""Width (inches) of the machine in the figure."""
READABLE = 0.75
"""Size of letters, over the usual one, below which labels say less."""
MARGIN = 0.4
"""Width of the margin for labels beside the tree, over that of the tree."""
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
    figure.savefig(path, dpi=180)
    return path


def _photograph(picture: Picture, spots: list[tuple[Mark, Spot]]) -> Figure:
    """The picture with a ring around every spot; the labels stand in a margin at the right."""
    height, width = picture.pixels.shape[:2]
    margin = 0.42 * width if spots else 0.0
    figure = Figure(figsize=(SIZE * (width + margin) / width, SIZE * height / width))
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.imshow(picture.pixels)
    ax.axis("off")
    ax.set_xlim(0, width + margin)
    ax.set_ylim(height, 0)
    labels, squeeze = _placed([mark for mark, _ in spots], picture.points, 0.0, float(height))
    for point, text, share in labels:
        _label(ax, point, text, (1.02 * width, share * height), 10 * squeeze)
    return figure


def _placed(
    marks: Sequence[Mark], points: Array, top: float, bottom: float
) -> tuple[list[tuple[tuple[float, float], str, float]], float]:
    """Points with their labels and the heights of these, in shares from the top, and by how much letters shrink. Where
    there is no room to read what is named at each place, the places are labelled alone; the page lists the rest.

    Args:
        points: [M, 2], of which the second coordinate grows downwards. top, bottom: of the picture.
    """
    for brief in (False, True):
        told = [Mark(m.kind, m.index, m.label.split("\n")[0]) for m in marks] if brief else marks
        labels = _by_point(told, points)
        wanted = [((y - top) / (bottom - top), len(lines)) for (_, y), lines in labels.items()]
        shares, squeeze = _stacked(wanted)
        if squeeze > READABLE:
            break
    return [(p, "\n".join(x), share) for (p, x), share in zip(labels.items(), shares, strict=True)], squeeze


def _by_point(marks: Sequence[Mark], points: Array) -> dict[tuple[float, float], list[str]]:
    """Lines of the label at every point, without repeating what stands there already; the highest in the picture (the
    least second coordinate) first."""
    labels: dict[tuple[float, float], list[str]] = {}
    for mark, (x, y) in zip(marks, points, strict=True):
        near = next((p for p in labels if np.hypot(p[0] - x, p[1] - y) < 1e-6), (float(x), float(y)))
        lines = labels.setdefault(near, [])
        lines += [line for line in mark.label.split("\n") if line not in lines]
    return dict(sorted(labels.items(), key=lambda item: item[0][1]))


def _stacked(wanted: Sequence[tuple[float, int]]) -> tuple[list[float], float]:
    """Heights of labels in a margin, in shares from the top, near those of their points but never one over another; and
    by how much their letters shrink for that. wanted: (share from the top, lines) of each, from the top."""
    need = [0.055 * (lines + 1) for _, lines in wanted]
    squeeze = min(1.0, 0.96 / max(sum(need), 1e-9))
    taken, out = 0.02, []
    for i, ((share, _), size) in enumerate(zip(wanted, need, strict=True)):
        latest = 0.98 - squeeze * sum(need[i:])
        taken = max(taken, min(share - 0.5 * size, latest))
        out.append(taken + 0.5 * squeeze * size)
        taken += squeeze * size
    return out, squeeze


def _label(ax: Axes, point: tuple[float, float], text: str, at: tuple[float, float], size: float) -> None:
    ax.plot(*point, "o", ms=20, mfc="none", mec="white", mew=4.0, zorder=3)
    ax.plot(*point, "o", ms=20, mfc="none", mec=_MARK, mew=2.2, zorder=4)
    ax.annotate(
        text, point, at, color=_MARK, ha="left", va="center", zorder=5, fontsize=size,
        bbox={"fc": "white", "ec": _MARK, "boxstyle": "round,pad=0.3"},
        arrowprops={"arrowstyle": "-", "color": _MARK, "shrinkB": 10},
    )  # fmt: skip


def segments(model: mujoco.MjModel, data: mujoco.MjData) -> list[tuple[Array, Array]]:
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


def plane(cloud: Array) -> list[int]:
    """The two axes of the world that show most of points [N, 3]: upright, unless they lie flat."""
    span = np.ptp(cloud, axis=0)
    return [0 if span[0] >= span[1] else 1, 2] if span[2] > 0.02 * span.max() else [0, 1]


def _tree(model: mujoco.MjModel, data: mujoco.MjData, spots: list[tuple[Mark, Spot]]) -> Figure:
    """The kinematic tree, seen along the axis in which it is thinnest."""
    links = segments(model, data)
    cloud = np.array([p for link in links for p in link] or [np.zeros(3)])
    span, view = np.ptp(cloud, axis=0), plane(cloud)
    figure = Figure(figsize=(SIZE * (1 + MARGIN) if spots else SIZE, 0.85 * SIZE), layout="constrained")
    ax = figure.subplots()
    for a, b in links:
        ax.plot(*np.array([a, b])[:, view].T, color="#8fa3b5", lw=6, solid_capstyle="round", zorder=1)
    pad = 0.15 * max(float(span.max()), 0.05)
    centre, half = 0.5 * (cloud.max(0) + cloud.min(0)), 0.5 * float(span.max()) + pad
    (left, right), (low, high) = ((centre[k] - half, centre[k] + half) for k in view)
    names = names_of(model)
    joints = [Mark("joint", j, names.joints[j][:16].replace("$", r"\$")) for j in range(model.njnt)]
    anchors = data.xanchor[:, view]
    ax.plot(*anchors.T, "o", color="#33424f", ms=5, zorder=2)
    marked = [spot.point[view] for _, spot in spots]
    free = [j for j in range(model.njnt) if all(np.hypot(*(anchors[j] - m)) > 1e-6 for m in marked)]
    if model.njnt <= 12:
        for point, lines in _by_point([joints[j] for j in free], anchors[free]).items():
            text = ", ".join(lines)
            ax.annotate(text, point, xytext=(7, 5), textcoords="offset points", fontsize=8)
    points = np.array(marked).reshape(-1, 2) * [1.0, -1.0]
    labels, squeeze = _placed([mark for mark, _ in spots], points, -high, -low)
    for (x, y), text, share in labels:
        at = (right + 0.02 * (right - left), high - share * (high - low))
        _label(ax, (x, -y), text, at, 9 * squeeze)
    ax.set_xlim(left, right + (MARGIN * (right - left) if spots else 0.0))
    ax.set_ylim(low, high)
    ax.set_aspect("equal")
    ax.set_xlabel(f"{'xyz'[view[0]]} (m)")
    ax.set_ylabel(f"{'xyz'[view[1]]} (m)")
    ax.grid(alpha=0.25)
    return figure
