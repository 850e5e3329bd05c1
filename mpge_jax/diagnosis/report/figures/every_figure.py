"""All figures of a diagnosis as PNG files."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.report.figures import (
    drawing,
    force_figures,
    motion_figures,
    motion_strip,
    whole_recordings,
)
from mpge_jax.diagnosis.report.figures.drawing import CORRECTED
from mpge_jax.diagnosis.report.figures.marks import Mark
from mpge_jax.diagnosis.report.figures.residual_figure import residual
from mpge_jax.diagnosis.report.figures.robot_picture import robot
from mpge_jax.diagnosis.verdict.location import locate
from mpge_jax.diagnosis.verdict.result import Result, ties_of


def location(d: Result, path: Path) -> Path:
    rows = locate(d)[:12]
    figure = Figure(figsize=(drawing.SMALL, 0.42 * len(rows) + 1.2), layout="constrained")
    ax = figure.subplots()
    ax.barh(range(len(rows)), [max(e, 1e-2) for _, _, e in rows], color="#6b6b6b")
    ax.axvline(1.0, color=CORRECTED, ls="--")
    ax.set_xlim(left=0.5 * min([1.0, *(max(e, 1e-2) for _, _, e in rows)]))
    drawing.log_scale(ax)
    ax.set_yticks(range(len(rows)), [f"{drawing.short(a, 18)} ({k})" for a, k, _ in rows])
    ax.invert_yaxis()
    ax.set_xlabel("missing force, squared, over what noise explains\n(1: nothing missing)")
    return drawing.save(figure, path)


def marks(d: Result) -> list[Mark]:
    """Every place that the diagnosis names: found, possible (the ambiguous ones) and unexplained."""

    def mark(term: Term, word: str = "") -> Mark:
        place, effect = term.place, term.name.replace("_", " ")
        text = (
            f"{word}{effect}" if place.kind == "world" else f"{drawing.short(place.name, 24)}\n{word}{effect}"
        )
        return Mark(place.kind, place.index, text)

    out = [mark(term) for term in d.terms]
    for _, fits in ties_of(d):
        out += [mark(t, "or ") for f in fits for t in f.hypothesis.named if t not in d.terms]
    if d.actuators is not None:
        out += [mark(term) for f in d.actuators.fits for term in f.hypothesis.terms]
    if d.unexplained is not None:
        names = d.prepared.names
        kinds = (("joint", names.joints), ("actuator", names.actuators), ("body", names.bodies))
        for at in d.unexplained["at"]:
            found = next(((kind, known.index(at)) for kind, known in kinds if at in known), ("world", 0))
            out.append(Mark(*found, f"{drawing.short(at, 24)}\nunexplained"))
    return list(dict.fromkeys(out))


def draw(d: Result, folder: Path) -> dict[str, Path]:
    """All figures; the key is what a figure shows (`whole` and `strip` only where a held-out recording can be
    predicted, `residual` where there is one)."""
    folder.mkdir(parents=True, exist_ok=True)
    p = d.prepared
    curves, bars = folder / "prediction.png", folder / "errors.png"
    map_of_time, all_of_it = folder / "residuals.png", folder / "whole.png"
    if isinstance(d.held, ForceErrors):
        shown = {
            "prediction": force_figures.forces(d, d.held, curves),
            "errors": force_figures.errors_by_actuator(d, d.held, bars),
            "residuals": force_figures.residual_map(d, d.held, map_of_time),
            "whole": force_figures.whole(d, d.held, all_of_it),
        }
    else:
        shown = {
            "prediction": motion_figures.prediction(d, d.held, curves),
            "errors": motion_figures.errors_by_joint(d, d.held, bars),
            "residuals": motion_figures.residual_map(d.held, map_of_time),
        }
        if recordings := whole_recordings.whole_recordings(d):
            shown["whole"] = whole_recordings.whole(d, d.held, recordings, all_of_it)
            shown["strip"] = motion_strip.strip(p, recordings[0], folder / "strip.png")
    if d.residual is not None:
        shown["residual"] = residual(d, d.residual.functions, folder / "residual.png")
    return shown | {
        "robot": robot(p.spec, p.model, p.test[0].states.qpos, marks(d), folder / "robot.png"),
        "location": location(d, folder / "location.png"),
    }
