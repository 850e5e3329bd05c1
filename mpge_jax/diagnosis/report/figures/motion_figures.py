"""Figures of predicted motion beside what was measured."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from matplotlib.figure import Figure

from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.machine.joint_space import difference
from mpge_jax.diagnosis.machine.model import is_scalar
from mpge_jax.diagnosis.report.error_words import error_unit, unit_of_joint
from mpge_jax.diagnosis.report.figures import drawing
from mpge_jax.diagnosis.report.figures.drawing import CORRECTED, NOMINAL
from mpge_jax.diagnosis.verdict.result import Result

Array = np.ndarray


def worst_dofs(report: FitReport, limit: int) -> list[int]:
    """Measured degrees of freedom, those that the nominal model predicts worst first."""
    before = report.before.joint
    order = np.argsort(-np.nan_to_num(before, nan=-1.0))
    return [int(i) for i in order if np.isfinite(before[i])][:limit]


def span(measured: Array, predicted: tuple[Array, ...], floor: float) -> tuple[float, float]:
    """Limits of an axis that holds what was measured, and predictions as far as they stay within its range of it."""
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    size = max(high - low, 6 * floor, 1e-4)
    every = np.concatenate([measured, *predicted])
    every = every[np.isfinite(every)]
    bottom, top = max(float(every.min()), low - size), min(float(every.max()), high + size)
    pad = 0.08 * max(top - bottom, size)
    return bottom - pad, top + pad


def prediction(d: Result, report: FitReport, path: Path) -> Path:
    """Held-out windows: measured motion, and what the nominal and the corrected model predict."""
    w, dofs = report.windows, worst_dofs(report, 4)
    # typical windows, not the most flattering ones: around the median of the nominal error
    order = np.argsort(report.before.window)
    middle = order[[len(order) // 4, len(order) // 2, (3 * len(order)) // 4]] if len(order) > 3 else order
    picks = list(dict.fromkeys(int(k) for k in middle))
    figure = Figure(figsize=(3.4 * len(picks) + 0.8, 1.9 * len(dofs) + 0.9), layout="constrained")
    axes = figure.subplots(len(dofs), len(picks), squeeze=False, sharex="col")
    model = d.prepared.model
    for i, dof in enumerate(dofs):
        joint = int(model.dof_jntid[dof])
        for j, k in enumerate(picks):
            seen = w.seen[k]
            t, ax = w.times[k][seen], axes[i, j]
            measured = measured_motion(model, w.qpos[k, seen], dof)
            given, corrected = (measured - e.curves[k, seen, dof] for e in (report.before, report.after))
            for y, color, style, width, label in drawing.curves(measured, given, corrected):
                ax.plot(t, y, color=color, ls=style, lw=width, label=label)
            ax.set_ylim(*span(measured, (given, corrected), report.floor))
            if i == 0:
                name = drawing.short(w.sources[w.source[k]].recording.name, 30)
                origin = w.sources[w.source[k]].recording.shown_origin
                ax.set_title(f"{name}, {origin + w.start[k]:.2f} s", fontsize=9)
            if j == 0:
                unit = unit_of_joint(d, f"{d.prepared.names.joints[joint]}:{dof}")
                ax.set_ylabel(
                    f"{drawing.short(d.prepared.names.joints[joint], 18)}{axis_of(model, dof)} ({unit})"
                )
            if i == len(dofs) - 1:
                ax.set_xlabel("time in window (s)")
            ax.grid(alpha=0.25)
    axes[0, 0].legend(fontsize=8)
    return drawing.save(figure, path)


def measured_motion(model: mujoco.MjModel, qpos: Array, dof: int) -> Array:
    """Measured positions [N] along a degree of freedom; rotations of ball and free joints since the first of them."""
    joint = int(model.dof_jntid[dof])
    index, column = dof - int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
    if is_scalar(model, joint) or (model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE and index < 3):
        return qpos[:, column + index]
    return difference(model, np.repeat(qpos[:1], len(qpos), 0), qpos)[:, dof]


def axis_of(model: mujoco.MjModel, dof: int) -> str:
    """What tells a degree of freedom from the others of its joint."""
    joint = int(model.dof_jntid[dof])
    if is_scalar(model, joint):
        return ""
    names = ("x", "y", "z", "about x", "about y", "about z")
    free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
    return f", {names[dof - int(model.jnt_dofadr[joint]) + (0 if free else 3)]}"


def errors_by_joint(d: Result, report: FitReport, path: Path) -> Path:
    """Held-out prediction error of every joint."""
    dofs = worst_dofs(report, 16)
    names = [d.prepared.names.joint_of_dof(d.prepared.model, k) for k in dofs]
    what = f"held-out error ({error_unit(d)}, rms over windows of {report.windows.times.max():.2g} s)"
    return drawing.bars(names, report.before.joint[dofs], report.after.joint[dofs], report.floor, what, path)


def residual_map(report: FitReport, path: Path) -> Path:
    """Error of every window over the recordings' time, before and after."""
    w = report.windows
    names = [s.recording.name for s in w.sources]
    present = sorted(set(w.source.tolist()))
    figure = Figure(figsize=(8.2, 0.9 * len(present) + 1.6), layout="constrained")
    ax = figure.subplots()
    marks = [(report.before, -0.12, NOMINAL), (report.after, 0.12, CORRECTED)]
    colors = "; red: as given, blue: corrected"
    if report.after is report.before:
        marks, colors = [(report.before, 0.0, NOMINAL)], ""
    for row, source in enumerate(present):
        mine = w.source == source
        t = w.sources[source].recording.shown_origin + w.start[mine] + 0.5 * w.times[mine].max(1)
        for errors, shift, color in marks:
            values = errors.window[mine]
            size = 4 + 240 * values / max(report.before.window.max(), 1e-12)
            ax.scatter(t, np.full(t.size, row + shift), s=size, color=color, alpha=0.65, lw=0)
    ax.set_yticks(range(len(present)), [drawing.short(names[s], 24) for s in present])
    ax.set_ylim(len(present) - 0.4, -0.6)
    ax.set_xlabel("time in the recording (s)")
    ax.set_title(f"Held-out error by window (area: error{colors})", fontsize=9)
    ax.grid(alpha=0.25)
    return drawing.save(figure, path)
