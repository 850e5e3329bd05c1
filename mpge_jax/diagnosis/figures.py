"""Figures of a diagnosis as PNG files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mpge_jax.diagnosis.robot_picture import robot

if TYPE_CHECKING:
    from mpge_jax.diagnosis.diagnosis import Diagnosis, FitReport

MEASURED, NOMINAL, CORRECTED = "#1b1b1b", "#c1502e", "#1f6fb2"


def _save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
    return path


def _dofs(d: Diagnosis, limit: int = 6) -> list[int]:
    """Measured degrees of freedom, those that the nominal model predicts worst first."""
    before = d.held.before.joint
    order = np.argsort(-np.nan_to_num(before, nan=-1.0))
    return [int(i) for i in order if np.isfinite(before[i])][:limit]


def prediction(d: Diagnosis, path: Path) -> Path:
    """Held-out windows: measured motion, and what the nominal and the corrected model predict."""
    report: FitReport = d.held
    w, dofs = report.windows, _dofs(d, 4)
    # typical windows, not the most flattering ones: around the median of the nominal error
    order = np.argsort(report.before.window)
    middle = order[[len(order) // 4, len(order) // 2, (3 * len(order)) // 4]] if len(order) > 3 else order
    picks = list(dict.fromkeys(int(k) for k in middle))
    figure = Figure(figsize=(3.4 * len(picks) + 0.8, 1.9 * len(dofs) + 0.9), layout="constrained")
    axes = figure.subplots(len(dofs), len(picks), squeeze=False, sharex="col")
    model = d.prepared.model
    for i, dof in enumerate(dofs):
        joint = int(model.dof_jntid[dof])
        column = int(model.jnt_qposadr[joint])
        for j, k in enumerate(picks):
            seen = w.seen[k]
            t, ax = w.times[k][seen], axes[i, j]
            measured = w.qpos[k, seen, column]
            ax.plot(t, measured, color=MEASURED, lw=2.4, label="measured")
            for curves, color, style, label in (
                (report.before.curves, NOMINAL, "--", "model as given"),
                (report.after.curves, CORRECTED, "-", "corrected model"),
            ):
                ax.plot(t, measured - curves[k, seen, dof], color=color, ls=style, lw=1.4, label=label)
            low, high = np.nanmin(measured), np.nanmax(measured)
            pad = max(high - low, 6 * report.floor, 1e-4)
            ax.set_ylim(low - pad, high + pad)
            if i == 0:
                name = w.sources[w.source[k]].recording.name
                ax.set_title(f"{name}, {w.start[k]:.2f} s", fontsize=9)
            if j == 0:
                ax.set_ylabel(d.prepared.names.joints[joint][:18])
            if i == len(dofs) - 1:
                ax.set_xlabel("time in window (s)")
            ax.grid(alpha=0.25)
    axes[0, 0].legend(fontsize=8)
    return _save(figure, path)


def errors_by_joint(d: Diagnosis, path: Path) -> Path:
    dofs = _dofs(d, 16)
    names = [d.prepared.names.joint_of_dof(d.prepared.model, k)[:18] for k in dofs]
    figure = Figure(figsize=(6.4, 0.55 * len(dofs) + 1.4), layout="constrained")
    ax = figure.subplots()
    y = np.arange(len(dofs))
    ax.barh(y - 0.2, d.held.before.joint[dofs], 0.38, color=NOMINAL, label="model as given")
    ax.barh(y + 0.2, d.held.after.joint[dofs], 0.38, color=CORRECTED, label="corrected model")
    ax.axvline(max(d.held.floor, 1e-9), color=MEASURED, ls=":", label="noise alone")
    ax.set_xscale("log")
    ax.set_yticks(y, names)
    ax.invert_yaxis()
    ax.set_xlabel(f"held-out prediction error (rms, {d.held.windows.times.max():.2g} s ahead)")
    ax.legend(fontsize=8)
    ax.grid(alpha=0.25, axis="x")
    return _save(figure, path)


def residual_map(d: Diagnosis, path: Path) -> Path:
    """Error of every window over the recordings' time, before and after."""
    w = d.held.windows
    names = [s.recording.name for s in w.sources]
    present = sorted(set(w.source.tolist()))
    figure = Figure(figsize=(8.2, 0.9 * len(present) + 1.6), layout="constrained")
    ax = figure.subplots()
    for row, source in enumerate(present):
        mine = w.source == source
        t = w.start[mine] + 0.5 * w.times[mine].max(1)
        for values, shift, color in (
            (d.held.before.window[mine], -0.12, NOMINAL),
            (d.held.after.window[mine], 0.12, CORRECTED),
        ):
            size = 12 + 240 * np.sqrt(values / max(d.held.before.window.max(), 1e-12))
            ax.scatter(t, np.full(t.size, row + shift), s=size, color=color, alpha=0.65, lw=0)
    ax.set_yticks(range(len(present)), [names[s][:24] for s in present])
    ax.set_ylim(len(present) - 0.4, -0.6)
    ax.set_xlabel("time in the recording (s)")
    ax.set_title("Held-out error by window (area: error; red: as given, blue: corrected)", fontsize=9)
    ax.grid(alpha=0.25)
    return _save(figure, path)


def location(d: Diagnosis, path: Path) -> Path:
    rows = d.location[:12]
    figure = Figure(figsize=(6.4, 0.42 * len(rows) + 1.3), layout="constrained")
    ax = figure.subplots()
    ax.barh(range(len(rows)), [max(e, 1e-2) for _, _, e in rows], color="#6b6b6b")
    ax.axvline(1.0, color=CORRECTED, ls="--")
    ax.set_xscale("log")
    ax.set_yticks(range(len(rows)), [f"{a[:18]} ({k})" for a, k, _ in rows])
    ax.invert_yaxis()
    ax.set_xlabel("missing force, squared, over what noise explains (1: nothing missing)")
    return _save(figure, path)


def draw(d: Diagnosis, folder: Path) -> dict[str, Path]:
    """All figures; the key is what a figure shows."""
    folder.mkdir(parents=True, exist_ok=True)
    marked = [(t.place.kind, t.place.index) for t in d.terms]
    if d.unexplained is not None:
        joints = [
            d.prepared.names.joints.index(a) for a in d.unexplained["at"] if a in d.prepared.names.joints
        ]
        marked += [("joint", j) for j in joints]
    return {
        "robot": robot(
            d.prepared.model, d.prepared.held_sources[0].states.qpos, marked, folder / "robot.png"
        ),
        "prediction": prediction(d, folder / "prediction.png"),
        "errors": errors_by_joint(d, folder / "errors.png"),
        "residuals": residual_map(d, folder / "residuals.png"),
        "location": location(d, folder / "location.png"),
    }
