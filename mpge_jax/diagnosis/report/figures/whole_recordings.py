"""Whole held-out recordings: what either model predicts from a recording's first row on, and what was measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mpge_jax.diagnosis.dataset.cut_windows import cut
from mpge_jax.diagnosis.dataset.starts_from_before import LEAD, started_from_before
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.prediction_error import Errors, errors
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.recordings.recording import Recording, longest_step
from mpge_jax.diagnosis.report.error_words import unit_of_joint
from mpge_jax.diagnosis.report.figures import drawing
from mpge_jax.diagnosis.report.figures.motion_figures import axis_of, measured_motion, span, worst_dofs
from mpge_jax.diagnosis.residual.model import with_residual
from mpge_jax.diagnosis.simulation.driving.actuator_state import settling
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import Windows
from mpge_jax.diagnosis.verdict.result import Result

RECORDINGS, JOINTS = 3, 3
"""Recordings, and joints of each, that are shown at most."""
STEPS, ROWS = 15_000, 600
"""Simulated steps, and rows of a recording, at most."""


@dataclass(frozen=True)
class Whole:
    """One recording, or its longest stretch without a gap, predicted open loop from its start.

    Attributes:
        windows: a single one. before, after: errors of the model as given and of the corrected one. modelled: of that
        with what is left as functions, where there are any.
    """

    windows: Windows
    before: Errors
    after: Errors
    modelled: Errors | None = None


def whole_recordings(d: Result) -> list[Whole]:
    """Predictions of the first held-out recordings."""
    p, out = d.prepared, []
    for source in p.test[:RECORDINGS]:
        length = min(_unbroken(source.recording) - max(settling(source, p.model), source.spent), STEPS * p.dt)
        rng = np.random.default_rng(0)
        w = cut((source,), p.model, p.noise, length, 1, p.dt, rng, ROWS)
        if w.count:
            w = started_from_before(w, p.model, p.noise, LEAD * p.config.report_s)
            before = errors(p.sim, NOTHING, w, p.noise)
            after = errors(p.sim, d.fit, w, p.noise) if d.terms else before
            modelled = None
            if d.residual is not None:
                modelled = errors(p.sim, with_residual(p.ctx, d.fit, d.residual), w, p.noise)
            out.append(Whole(w, before, after, modelled))
    return out


def _unbroken(r: Recording) -> float:
    """Length (s) of the longest stretch without a gap."""
    ends = np.flatnonzero(np.append(np.diff(r.time) > longest_step(r), True))
    starts = np.append(0, ends[:-1] + 1)
    return float((r.time[ends] - r.time[starts]).max())


def whole(d: Result, report: FitReport, shown: list[Whole], path: Path) -> Path:
    """The figure of one or more recordings."""
    dofs = worst_dofs(report, JOINTS)
    figure = Figure(figsize=(9.6, 1.7 * len(dofs) * len(shown) + 0.6), layout="constrained")
    axes = figure.subplots(len(dofs) * len(shown), 1, squeeze=False)[:, 0]
    for k, one in enumerate(shown):
        rows = axes[k * len(dofs) : (k + 1) * len(dofs)]
        rows[0].set_title(_title(one.windows.sources[0], one.windows), fontsize=9, loc="right")
        for ax, dof in zip(rows, dofs, strict=True):
            _curves(d, one, dof, ax, report.floor)
    drawing.legend_above(axes[0])
    axes[-1].set_xlabel("time in the recording (s)")
    return drawing.save(figure, path)


def _title(source: Source, w: Windows) -> str:
    """Its name, and which part of it is shown where rows were lost or it is too long."""
    r, begin = source.recording, float(w.start[0])
    end = begin + float(w.times.max())
    whole = _unbroken(r) >= r.duration and end > 0.95 * r.duration
    part = "" if whole else f", {r.shown_origin + begin:.3g} to {r.shown_origin + end:.3g} s"
    return f"{drawing.short(r.name, 40)}{part}"


def _curves(d: Result, one: Whole, dof: int, ax: Axes, floor: float) -> None:
    """One joint over one recording."""
    w, model = one.windows, d.prepared.model
    seen = w.seen[0]
    measured = measured_motion(model, w.qpos[0, seen], dof)
    models = [e for e in (one.before, one.after, one.modelled) if e is not None]
    predicted = [measured - e.curves[0, seen, dof] for e in models]
    t = w.sources[0].recording.shown_origin + w.start[0] + w.times[0][seen]
    joint = d.prepared.names.joints[int(model.dof_jntid[dof])]
    for y, color, style, width, label in drawing.curves(measured, *predicted):
        ax.plot(t, y, color=color, ls=style, lw=width, label=label)
    ax.set_ylim(*span(measured, tuple(predicted), floor))
    ax.set_ylabel(f"{drawing.short(joint, 18)}{axis_of(model, dof)} ({unit_of_joint(d, f'{joint}:{dof}')})")
    ax.grid(alpha=0.25)
