"""Figures of a diagnosis as PNG files."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.machine.joint_space import difference
from mpge_jax.diagnosis.machine.model import is_scalar
from mpge_jax.diagnosis.report.force_errors import ForceErrors, force_errors, motion_is_given
from mpge_jax.diagnosis.report.marks import Mark
from mpge_jax.diagnosis.report.robot_picture import robot
from mpge_jax.diagnosis.report.sentences import error_unit, unit_of_joint
from mpge_jax.diagnosis.verdict.location import locate
from mpge_jax.diagnosis.verdict.result import Result, candidates_of

Array = np.ndarray
MEASURED, NOMINAL, CORRECTED = "#1b1b1b", "#c1502e", "#1f6fb2"


def _save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
    return path


def _name(text: str, most: int) -> str:
    """A name from a model or a file as matplotlib shall write it: short, and never as a formula."""
    return text[:most].replace("$", r"\$")


def _log_scale(ax: Axes) -> None:
    """A logarithmic x axis with few plain numbers, also where it spans less than a decade."""
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 100 * low else (1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())


def _dofs(d: Result, limit: int = 6) -> list[int]:
    """Measured degrees of freedom, those that the nominal model predicts worst first."""
    before = d.held.before.joint
    order = np.argsort(-np.nan_to_num(before, nan=-1.0))
    return [int(i) for i in order if np.isfinite(before[i])][:limit]


def _span(measured: Array, predicted: tuple[Array, ...], floor: float) -> tuple[float, float]:
    """Limits of an axis that holds what was measured, and predictions as far as they stay within its range of it."""
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    size = max(high - low, 6 * floor, 1e-4)
    every = np.concatenate([measured, *predicted])
    every = every[np.isfinite(every)]
    bottom, top = max(float(every.min()), low - size), min(float(every.max()), high + size)
    pad = 0.08 * max(top - bottom, size)
    return bottom - pad, top + pad


def prediction(d: Result, path: Path) -> Path:
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
        for j, k in enumerate(picks):
            seen = w.seen[k]
            t, ax = w.times[k][seen], axes[i, j]
            measured = _measured(model, w.qpos[k, seen], dof)
            ax.plot(t, measured, color=MEASURED, lw=2.4, label="measured")
            given, corrected = (measured - e.curves[k, seen, dof] for e in (report.before, report.after))
            ax.plot(t, given, color=NOMINAL, ls="--", lw=1.4, label="model as given")
            ax.plot(t, corrected, color=CORRECTED, ls="-", lw=1.4, label="corrected model")
            ax.set_ylim(*_span(measured, (given, corrected), report.floor))
            if i == 0:
                name = _name(w.sources[w.source[k]].recording.name, 30)
                origin = w.sources[w.source[k]].recording.shown_origin
                ax.set_title(f"{name}, {origin + w.start[k]:.2f} s", fontsize=9)
            if j == 0:
                unit = unit_of_joint(d, f"{d.prepared.names.joints[joint]}:{dof}")
                ax.set_ylabel(f"{_name(d.prepared.names.joints[joint], 18)}{_axis(model, dof)} ({unit})")
            if i == len(dofs) - 1:
                ax.set_xlabel("time in window (s)")
            ax.grid(alpha=0.25)
    axes[0, 0].legend(fontsize=8)
    return _save(figure, path)


def _measured(model: mujoco.MjModel, qpos: Array, dof: int) -> Array:
    """Measured positions [N] along a degree of freedom; rotations of ball and free joints since the first of them."""
    joint = int(model.dof_jntid[dof])
    index, column = dof - int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
    if is_scalar(model, joint) or (model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE and index < 3):
        return qpos[:, column + index]
    return difference(model, np.repeat(qpos[:1], len(qpos), 0), qpos)[:, dof]


def _axis(model: mujoco.MjModel, dof: int) -> str:
    """What tells a degree of freedom from the others of its joint."""
    joint = int(model.dof_jntid[dof])
    if is_scalar(model, joint):
        return ""
    names = ("x", "y", "z", "about x", "about y", "about z")
    free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
    return f", {names[dof - int(model.jnt_dofadr[joint]) + (0 if free else 3)]}"


def forces(d: Result, e: ForceErrors, path: Path) -> Path:
    """Held-out forces: measured, and what the nominal and the corrected model need for the recorded motion."""
    actuators = np.flatnonzero(np.isfinite(e.each_before))[:4]
    traces = e.traces[:3]
    figure = Figure(figsize=(3.4 * len(traces) + 0.8, 1.9 * len(actuators) + 0.9), layout="constrained")
    axes = figure.subplots(len(actuators), len(traces), squeeze=False, sharex="col")
    for j, trace in enumerate(traces):
        # two seconds around the middle: more would hide how the curves run
        middle = 0.5 * (trace.time[0] + trace.time[-1])
        near = np.abs(trace.time - middle) < 1.0
        axes[0, j].set_title(_name(trace.name, 30), fontsize=9)
        axes[-1, j].set_xlabel("time (s)")
        for i, a in enumerate(actuators):
            for values, color, style, width, label in (
                (trace.measured, MEASURED, "-", 2.4, "measured"),
                (trace.before, NOMINAL, "--", 1.4, "model as given"),
                (trace.after, CORRECTED, "-", 1.4, "corrected model"),
            ):
                axes[i, j].plot(
                    trace.time[near], values[near, a], color=color, ls=style, lw=width, label=label
                )
            axes[i, j].grid(alpha=0.25)
    for i, a in enumerate(actuators):
        axes[i, 0].set_ylabel(f"{_name(d.prepared.names.actuators[a], 18)} ({error_unit(d)})")
    axes[0, 0].legend(fontsize=8)
    return _save(figure, path)


def errors_by_joint(d: Result, path: Path) -> Path:
    """Held-out prediction error of every joint."""
    dofs = _dofs(d, 16)
    names = [d.prepared.names.joint_of_dof(d.prepared.model, k) for k in dofs]
    what = (
        f"held-out prediction error ({error_unit(d)}, rms over windows of {d.held.windows.times.max():.2g} s)"
    )
    return _bars(names, d.held.before.joint[dofs], d.held.after.joint[dofs], d.held.floor, what, path)


def errors_by_actuator(d: Result, e: ForceErrors, path: Path) -> Path:
    """Held-out error of every actuator's predicted force."""
    a = np.flatnonzero(np.isfinite(e.each_before))[:16]
    names = [d.prepared.names.actuators[k] for k in a]
    return _bars(names, e.each_before[a], e.each_after[a], e.floor, "held-out error of the force (rms)", path)


def _bars(names: list[str], before: Array, after: Array, floor: float, what: str, path: Path) -> Path:
    figure = Figure(figsize=(6.4, 0.55 * len(names) + 1.4), layout="constrained")
    ax = figure.subplots()
    y = np.arange(len(names))
    ax.barh(y - 0.2, before, 0.38, color=NOMINAL, label="model as given")
    ax.barh(y + 0.2, after, 0.38, color=CORRECTED, label="corrected model")
    ax.axvline(max(floor, 1e-9), color=MEASURED, ls=":", label="noise alone, all together")
    _log_scale(ax)
    ax.set_yticks(y, [_name(name, 18) for name in names])
    ax.invert_yaxis()
    ax.set_xlabel(what)
    ax.legend(fontsize=8)
    ax.grid(alpha=0.25, axis="x")
    return _save(figure, path)


def residual_map(d: Result, path: Path) -> Path:
    """Error of every window over the recordings' time, before and after."""
    w = d.held.windows
    names = [s.recording.name for s in w.sources]
    present = sorted(set(w.source.tolist()))
    figure = Figure(figsize=(8.2, 0.9 * len(present) + 1.6), layout="constrained")
    ax = figure.subplots()
    for row, source in enumerate(present):
        mine = w.source == source
        t = w.sources[source].recording.shown_origin + w.start[mine] + 0.5 * w.times[mine].max(1)
        for values, shift, color in (
            (d.held.before.window[mine], -0.12, NOMINAL),
            (d.held.after.window[mine], 0.12, CORRECTED),
        ):
            size = 4 + 240 * values / max(d.held.before.window.max(), 1e-12)
            ax.scatter(t, np.full(t.size, row + shift), s=size, color=color, alpha=0.65, lw=0)
    ax.set_yticks(range(len(present)), [_name(names[s], 24) for s in present])
    ax.set_ylim(len(present) - 0.4, -0.6)
    ax.set_xlabel("time in the recording (s)")
    ax.set_title("Held-out error by window (area: error; red: as given, blue: corrected)", fontsize=9)
    ax.grid(alpha=0.25)
    return _save(figure, path)


def location(d: Result, path: Path) -> Path:
    rows = locate(d)[:12]
    figure = Figure(figsize=(6.4, 0.42 * len(rows) + 1.3), layout="constrained")
    ax = figure.subplots()
    ax.barh(range(len(rows)), [max(e, 1e-2) for _, _, e in rows], color="#6b6b6b")
    ax.axvline(1.0, color=CORRECTED, ls="--")
    _log_scale(ax)
    ax.set_yticks(range(len(rows)), [f"{_name(a, 18)} ({k})" for a, k, _ in rows])
    ax.invert_yaxis()
    ax.set_xlabel("missing force, squared, over what noise explains (1: nothing missing)")
    return _save(figure, path)


def marks(d: Result) -> list[Mark]:
    """Every place that the diagnosis names: found, possible (the ambiguous ones) and unexplained."""

    def mark(term: Term, word: str = "") -> Mark:
        place, effect = term.place, term.name.replace("_", " ")
        text = f"{word}{effect}" if place.kind == "world" else f"{_name(place.name, 24)}\n{word}{effect}"
        return Mark(place.kind, place.index, text)

    out = [mark(term) for term in d.terms]
    for fits in candidates_of(d).values():
        out += [mark(t, "or ") for f in fits for t in f.hypothesis.terms if t not in d.terms]
    if d.actuators is not None:
        out += [mark(term) for f in d.actuators.fits for term in f.hypothesis.terms]
    if d.unexplained is not None:
        names = d.prepared.names
        kinds = (("joint", names.joints), ("actuator", names.actuators), ("body", names.bodies))
        for at in d.unexplained["at"]:
            found = next(((kind, known.index(at)) for kind, known in kinds if at in known), ("world", 0))
            out.append(Mark(*found, f"{_name(at, 24)}\nunexplained"))
    return list(dict.fromkeys(out))


def draw(d: Result, folder: Path) -> dict[str, Path]:
    """All figures; the key is what a figure shows."""
    folder.mkdir(parents=True, exist_ok=True)
    p = d.prepared
    curves, bars = folder / "prediction.png", folder / "errors.png"
    if motion_is_given(d):
        e = force_errors(d, held=True)
        shown = {"prediction": forces(d, e, curves), "errors": errors_by_actuator(d, e, bars)}
    else:
        shown = {"prediction": prediction(d, curves), "errors": errors_by_joint(d, bars)}
    return shown | {
        "robot": robot(p.spec, p.model, p.held_sources[0].states.qpos, marks(d), folder / "robot.png"),
        "residuals": residual_map(d, folder / "residuals.png"),
        "location": location(d, folder / "location.png"),
    }
