"""The robot with the place of an effect marked: a drawn kinematic tree, which needs no graphics driver."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mpge_jax.diagnosis.model import names_of

Array = np.ndarray
_MARK = "#d62718"


def _points(model: mujoco.MjModel, data: mujoco.MjData) -> list[tuple[Array, Array]]:
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


_LONG = [int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER)]


def place_of(model: mujoco.MjModel, data: mujoco.MjData, kind: str, index: int) -> Array | None:
    """World position of an element."""
    if kind == "joint":
        return data.xanchor[index]
    if kind == "actuator" and model.actuator_trntype[index] == int(mujoco.mjtTrn.mjTRN_JOINT):
        return data.xanchor[model.actuator_trnid[index, 0]]
    if kind == "body":
        return data.xipos[index]
    if kind == "geom":
        return data.geom_xpos[index]
    return None


def robot(model: mujoco.MjModel, qpos: Array, marked: list[tuple[str, int]], path: Path) -> Path:
    """Draw the machine in the pose of the middle of a recording, seen along the axis it moves least."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos[len(qpos) // 2]
    mujoco.mj_forward(model, data)
    lines = _points(model, data)
    cloud = np.array([p for line in lines for p in line] or [np.zeros(3)])
    span = np.ptp(cloud, axis=0)
    horizontal = 0 if span[0] >= span[1] else 1
    view = [horizontal, 2] if span[2] > 0.02 * span.max() else [0, 1]
    figure = Figure(figsize=(4.6, 4.2), layout="constrained")
    ax = figure.subplots()
    for a, b in lines:
        ax.plot(*np.array([a, b])[:, view].T, color="#8fa3b5", lw=6, solid_capstyle="round", zorder=1)
    names = names_of(model)
    for j in range(model.njnt):
        x, y = data.xanchor[j][view]
        ax.plot(x, y, "o", color="#33424f", ms=5, zorder=2)
        if model.njnt <= 12:
            ax.annotate(names.joints[j][:16], (x, y), xytext=(7, 5), textcoords="offset points", fontsize=8)
    for kind, index in marked:
        point = place_of(model, data, kind, index)
        if point is not None:
            ax.plot(*point[view], "o", ms=24, mfc="none", mec=_MARK, mew=2.6, zorder=3)
    if any(kind == "world" for kind, _ in marked):
        ax.text(0.02, 0.98, "acts on the whole machine", color=_MARK, transform=ax.transAxes, va="top")
    pad = 0.15 * max(float(span.max()), 0.05)
    centre, half = 0.5 * (cloud.max(0) + cloud.min(0)), 0.5 * float(span.max()) + pad
    ax.set_xlim(centre[view[0]] - half, centre[view[0]] + half)
    ax.set_ylim(centre[view[1]] - half, centre[view[1]] + half)
    ax.set_aspect("equal")
    ax.set_xlabel(f"{'xyz'[view[0]]} (m)")
    ax.set_ylabel(f"{'xyz'[view[1]]} (m)")
    ax.grid(alpha=0.25)
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
    return path
