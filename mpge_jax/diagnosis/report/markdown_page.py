"""A diagnosis as a Markdown page; every number comes from the diagnosis itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.report.error_words import no_physics
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


def _by_joint(d: Result, table: dict[str, Any]) -> list[str]:
    """The section with a row for every joint."""
    names, held = table["fit"]["held_out"]["recordings"], d.held
    if isinstance(held, ForceErrors):
        head = ["", "## Held-out forces", "", f"{len(held.balance.measured)} rows of {', '.join(names)}.", ""]
        head += ["| joint | rms error as given | rms error corrected | ratio |", "|---|---|---|---|"]
        rows = [(name, *errors) for name, errors in table["fit"]["held_out"]["per_joint"].items()]
    else:
        head = ["", f"## Held-out windows of {table['fit']['window_s']} s", ""]
        head += [f"{held.windows.count} windows of {', '.join(names)}.", ""]
        head += ["| joint | median error as given | median error corrected | ratio |", "|---|---|---|---|"]
        before, after = window_errors(held, False), window_errors(held, True)
        dofs = map(int, np.flatnonzero(np.isfinite(before)))
        rows = [(d.prepared.names.joint_of_dof(d.prepared.model, k), before[k], after[k]) for k in dofs]
    return head + [f"| {name} | {a:.4g} | {b:.4g} | {a / b:.1f} |" for name, a, b in rows]


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
    lines += _by_joint(d, table)
    fit, alone = table["fit"]["held_out"], no_physics(not isinstance(d.held, ForceErrors))
    lines += [
        "",
        f"Root mean square over all: {fit['before']} to {fit['after']} ({alone} {fit['noise_floor']}).",
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
