"""A held-out recording at several moments: the machine as measured, and where either model has it by then."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.prediction_error import Errors
from mpge_jax.diagnosis.report.figures import drawing
from mpge_jax.diagnosis.report.figures.drawing import CORRECTED, NOMINAL
from mpge_jax.diagnosis.report.figures.robot_picture import plane, segments
from mpge_jax.diagnosis.report.figures.robot_render import render_frames
from mpge_jax.diagnosis.report.figures.whole_recordings import Whole

Array = np.ndarray
FRAMES, COLUMNS = 6, 3
MEASURED = "#8c8c8c"
GHOSTS = np.array([[0.80, 0.24, 0.10, 0.5], [0.10, 0.42, 0.75, 0.5]], np.float32)
"""Colours (RGBA) of the model as given and of the corrected one, over the machine as measured."""
WHITE, EDGE = 250, 12
"""Brightness from which on a pixel is empty, and pixels that are kept of it around what is not."""
AWAY = 1.0
"""By how many times the size of what was measured a figure of lines shows models beside it."""


def strip(p: Prepared, one: Whole, path: Path) -> Path:
    """The figure, rendered by MuJoCo, or as lines where that fails."""
    times, frames = poses(p, one)
    count, pictures = len(times), render_frames(p.spec, frames, GHOSTS[: frames.shape[1] - 1])
    aspect = 0.8
    if pictures is not None:
        pictures = cropped(pictures)
        aspect = pictures.shape[1] / pictures.shape[2]
    rows = -(-count // COLUMNS)
    figure = Figure(figsize=(9.6, rows * (9.6 / COLUMNS * aspect + 0.3) + 0.35), layout="constrained")
    axes = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    if pictures is None:
        _lines(p.model, frames, axes[:count])
    for k, ax in enumerate(axes):
        if k < count and pictures is not None:
            ax.imshow(pictures[k])
        if k < count:
            ax.set_title(f"{times[k]:.2f} s", fontsize=9)
        ax.axis("off")
    names = ["measured", "model as given", "corrected model"][: frames.shape[1]]
    shown = zip(names, (MEASURED, NOMINAL, CORRECTED), strict=False)
    handles = [Patch(color=c, label=name) for name, c in shown]
    figure.legend(handles=handles, loc="outside upper left", ncols=3, frameon=False, fontsize=8)
    return drawing.save(figure, path)


def poses(p: Prepared, one: Whole) -> tuple[Array, Array]:
    """Moments [F] s of the recording, evenly spread, and poses [F, K, nq] as measured, as given and (where that is
    another model) as corrected. What was never measured stays where the model has it; NaN where a model runs away."""
    w = one.windows
    seen = np.flatnonzero(w.seen[0])
    rows = seen[np.unique(np.linspace(0, seen.size - 1, FRAMES).round().astype(int))]
    models: list[Errors] = [one.before] if one.after is one.before else [one.before, one.after]
    out = np.full((rows.size, 1 + len(models), p.model.nq), np.nan)
    for f, row in enumerate(rows):
        measured = w.qpos[0, row]
        out[f, 0] = np.where(np.isnan(measured), p.model.qpos0, measured)
        for k, errors in enumerate(models, 1):
            error, pose = errors.curves[0, row], out[f, 0].copy()
            moved = np.where(np.isnan(error), 0.0, -error)
            if np.isfinite(moved).all():
                mujoco.mj_integratePos(p.model, pose, moved, 1.0)
                out[f, k] = pose
    return w.sources[0].recording.shown_origin + w.start[0] + w.times[0][rows], out


def cropped(pictures: Array) -> Array:
    """Pictures [F, h, w, 3] without the white that all have around what they show."""
    inked = np.any(pictures < WHITE, axis=(0, 3))
    (top, bottom), (left, right) = (
        (max(int(k.min()) - EDGE, 0), int(k.max()) + EDGE + 1)
        for k in (np.flatnonzero(np.any(inked, axis=1)), np.flatnonzero(np.any(inked, axis=0)))
    )
    return pictures[:, top:bottom, left:right]


def _lines(model: mujoco.MjModel, frames: Array, axes: Array) -> None:
    """Lines between joints, seen along the axis in which the machine as measured is thinnest."""
    data = mujoco.MjData(model)

    def drawn(pose: Array) -> Array:
        """[S, 2, 3] ends of lines; none of a model that ran away."""
        if not np.isfinite(pose).all():
            return np.zeros((0, 2, 3))
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        return np.array(segments(model, data)).reshape(-1, 2, 3)

    every = [[drawn(pose) for pose in frame] for frame in frames]
    cloud = np.concatenate([lines[0] for lines in every]).reshape(-1, 3)
    view = plane(cloud)
    low, high = cloud.min(0)[view], cloud.max(0)[view]
    near = np.concatenate([x for lines in every for x in lines]).reshape(-1, 3)[:, view]
    size = AWAY * max(float((high - low).max()), 1e-3)
    low, high = np.maximum(near.min(0), low - size), np.minimum(near.max(0), high + size)
    middle, half = 0.5 * (low + high), 0.55 * max(float((high - low).max()), 1e-3)
    for ax, lines in zip(axes, every, strict=True):
        for ends, style in zip(lines, STYLES, strict=False):
            _drawn_in(ax, ends[:, :, view], style)
        ax.set_xlim(middle[0] - half, middle[0] + half)
        ax.set_ylim(middle[1] - half, middle[1] + half)
        ax.set_aspect("equal")


STYLES = ((MEASURED, 6.0, "-"), (NOMINAL, 1.8, "--"), (CORRECTED, 1.8, "-"))


def _drawn_in(ax: Axes, ends: Array, style: tuple[str, float, str]) -> None:
    color, width, dashes = style
    for a, b in ends:
        ax.add_line(Line2D(*np.array([a, b]).T, color=color, lw=width, ls=dashes, solid_capstyle="round"))
