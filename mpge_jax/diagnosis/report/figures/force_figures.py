"""Figures of forces that a recorded motion needs, beside what was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.machine.model import is_joint_transmission
from mpge_jax.diagnosis.report.error_words import unit_of_joint
from mpge_jax.diagnosis.report.figures import drawing
from mpge_jax.diagnosis.report.figures.drawing import CORRECTED, NOMINAL
from mpge_jax.diagnosis.residual.model import with_residual
from mpge_jax.diagnosis.verdict.result import Result

Array = np.ndarray
SHOWN, PERIOD = 4, 4.0
"""Actuators that are shown, those with the largest error as given over their force; and seconds of time."""
RECORDINGS, OF_EACH = 3, 3
"""Whole recordings, and actuators of each, that are shown."""


def forces(d: Result, e: ForceErrors, path: Path) -> Path:
    """Held-out forces over time and, on the right, over position, where friction is a loop and a gap a step in it."""
    shown = _worst(e)
    figure = Figure(figsize=(9.6, 1.9 * len(shown) + 0.9), layout="constrained")
    axes = figure.subplots(len(shown), 2, squeeze=False, width_ratios=(2, 1))
    track = e.balance.tracks[0]
    # a few seconds around the middle: more would hide how the curves run
    near = np.abs(track.time - 0.5 * (track.time[0] + track.time[-1])) < 0.5 * PERIOD
    origin = d.prepared.test[0].recording.shown_origin
    m, names = d.prepared.model, d.prepared.names
    for (ax, loop), a in zip(axes, shown, strict=True):
        for values, color, style, width, label in drawing.curves(e.balance.measured, e.given, e.corrected):
            force = values[: near.size, a][near]
            ax.plot(origin + track.time[near], force, color=color, ls=style, lw=width, label=label)
            if is_joint_transmission(m, a):
                q = track.q[near, m.jnt_qposadr[m.actuator_trnid[a, 0]]]
                loop.plot(q, force, color=color, ls=style, lw=0.8 * width)
        ax.set_ylabel(f"{drawing.short(names.actuators[a], 18)} ({unit_of_joint(d, names.driven_by(m, a))})")
        loop.xaxis.set_major_locator(MaxNLocator(4))
        for one in (ax, loop):
            one.grid(alpha=0.25)
    axes[0, 0].set_title(drawing.short(track.name, 40), fontsize=9)
    axes[0, 1].set_title("over the joint's position", fontsize=9)
    axes[-1, 0].set_xlabel("time (s)")
    axes[-1, 1].set_xlabel("position (rad or m)")
    axes[0, 0].legend(fontsize=8)
    return drawing.save(figure, path)


def whole(d: Result, e: ForceErrors, path: Path) -> Path:
    """Held-out forces over whole recordings."""
    shown, tracks = _worst(e)[:OF_EACH], e.balance.tracks[:RECORDINGS]
    figure = Figure(figsize=(9.6, 1.7 * len(shown) * len(tracks) + 0.6), layout="constrained")
    axes = figure.subplots(len(shown) * len(tracks), 1, squeeze=False)[:, 0]
    m, names = d.prepared.model, d.prepared.names
    predicted = [e.given, e.corrected]
    if d.residual is not None:
        modelled = with_residual(d.ctx, d.fit, d.residual)
        predicted.append(e.balance.predicted_by(modelled))
    first = 0
    for k, (track, source) in enumerate(zip(tracks, d.prepared.test, strict=False)):
        rows = slice(first, first + len(track.time))
        first += len(track.time)
        time = source.recording.shown_origin + track.time
        for ax, a in zip(axes[k * len(shown) :], shown, strict=False):
            for values, color, style, width, label in drawing.curves(e.balance.measured, *predicted):
                ax.plot(time, values[rows, a], color=color, ls=style, lw=width, label=label)
            unit = unit_of_joint(d, names.driven_by(m, a))
            ax.set_ylabel(f"{drawing.short(names.actuators[a], 18)} ({unit})")
            ax.grid(alpha=0.25)
        axes[k * len(shown)].set_title(drawing.short(track.name, 40), fontsize=9, loc="right")
    drawing.legend_above(axes[0])
    axes[-1].set_xlabel("time in the recording (s)")
    return drawing.save(figure, path)


def errors_by_actuator(d: Result, e: ForceErrors, path: Path) -> Path:
    """Held-out error of every actuator's predicted force."""
    a = np.flatnonzero(np.isfinite(e.each_before))[:16]
    names = [d.prepared.names.actuators[k] for k in a]
    return drawing.bars(
        names, e.each_before[a], e.each_after[a], e.floor, "held-out error of the force (rms)", path
    )


def residual_map(d: Result, e: ForceErrors, path: Path) -> Path:
    """Error over the recordings' time, before and after: of all actuators, each in shares of its force."""
    size = e.size
    before, after = (
        np.sqrt(np.nanmean(((x - e.balance.measured) / size) ** 2, 1)) for x in (e.given, e.corrected)
    )
    tracks = e.balance.tracks[:6]
    figure = Figure(figsize=(8.2, 1.3 * len(tracks) + 0.9), layout="constrained")
    axes = figure.subplots(len(tracks), 1, squeeze=False)[:, 0]
    first = 0
    for ax, t, s in zip(axes, tracks, d.prepared.test, strict=False):
        rows = slice(first, first + len(t.time))
        first += len(t.time)
        time = s.recording.shown_origin + t.time
        ax.fill_between(time, before[rows], color=NOMINAL, alpha=0.5, lw=0, label="model as given")
        if not np.array_equal(before, after):
            ax.fill_between(time, after[rows], color=CORRECTED, alpha=0.8, lw=0, label="corrected model")
        ax.set_ylabel("error / force")
        ax.set_title(drawing.short(t.name, 40), fontsize=9)
        ax.grid(alpha=0.25)
    axes[0].legend(fontsize=8)
    axes[-1].set_xlabel("time in the recording (s)")
    return drawing.save(figure, path)


def _worst(e: ForceErrors) -> list[int]:
    share = np.nan_to_num(e.each_before / e.size, nan=-1.0)
    return sorted(int(a) for a in np.argsort(-share)[:SHOWN] if share[a] >= 0)
