"""A diagnosis as a Markdown page; every number comes from the diagnosis itself."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.report.sentences import effect_rows
from mpge_jax.diagnosis.report.tables import diagnosis_table
from mpge_jax.diagnosis.verdict.result import Result

Array = np.ndarray


def window_errors(report: FitReport, after: bool) -> Array:
    """Median over windows of each joint's root-mean-square error [nv]; NaN where it was never measured."""
    curves = (report.after if after else report.before).curves
    seen = np.isfinite(curves)
    count = seen.sum(1)
    each = np.sqrt((np.where(seen, curves, 0.0) ** 2).sum(1) / np.maximum(count, 1))
    return np.array(
        [np.median(e[n > 0]) if n.any() else np.nan for e, n in zip(each.T, count.T, strict=True)]
    )


def markdown(d: Result, title: str, command: str) -> str:
    """A page: the sentences, effects with intervals, held-out errors, warnings, and how it was made."""
    table = diagnosis_table(d)
    lines = [
        f"# {title}",
        "",
        f"Verdict: **{table['verdict']}**. {table['explanation']}",
        "",
        "## Effects",
        "",
    ]
    lines += [
        "| effect | at | parameter | value | 95 % interval | held-out error without it |",
        "|---|---|---|---|---|---|",
    ]
    lines += [f"| {' | '.join(row)} |" for row in effect_rows(table)]
    held = d.held
    before, after = window_errors(held, False), window_errors(held, True)
    span = table["fit"]["window_s"]
    lines += ["", f"## Held-out windows of {span} s", ""]
    lines += [f"{held.windows.count} windows of {', '.join(table['fit']['held_out']['recordings'])}.", ""]
    lines += ["| joint | median error as given | median error corrected | ratio |", "|---|---|---|---|"]
    for dof in map(int, np.flatnonzero(np.isfinite(before))):
        name = d.prepared.names.joint_of_dof(d.prepared.model, dof)
        lines.append(f"| {name} | {before[dof]:.4g} | {after[dof]:.4g} | {before[dof] / after[dof]:.1f} |")
    fit = table["fit"]["held_out"]
    lines += [
        "",
        f"Root mean square over all: {fit['before']} to {fit['after']} (noise alone: {fit['noise_floor']}).",
    ]
    if d.actuators is not None and d.actuators.errors:
        lines += [
            "",
            "## Command to measured force",
            "",
            "| actuator | held-out rms before | after |",
            "|---|---|---|",
        ]
        lines += [f"| {a} | {x:.4g} | {y:.4g} |" for a, (x, y) in d.actuators.errors.items()]
    if table["warnings"]:
        lines += ["", "## Warnings", "", *[f"- {w}" for w in table["warnings"]]]
    lines += ["", f"Made by `{command}`, seed {table['seed']}.", ""]
    return "\n".join(lines)
