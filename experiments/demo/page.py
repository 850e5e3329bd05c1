"""The one page of the demonstration."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from experiments.demo.figure import returns_figure
from experiments.demo.simulated import Simulated
from mpge_jax.diagnosis.estimation.quantities import intervals, quantity
from mpge_jax.diagnosis.report.error_words import times
from mpge_jax.diagnosis.report.html_sections import image, table
from mpge_jax.diagnosis.report.sentences import effect_rows
from mpge_jax.diagnosis.report.style import STYLE

EFFECTS = 8
"""Rows of the real machine's effects that are shown."""


def page(arm: Simulated, out: Path, machine: Path, seconds: float | None) -> str:
    """HTML of the page; pictures are within it, links lead to files beside it.

    Args:
        arm: what came of the simulated arm. out: the folder with both diagnoses. machine: the real machine's files.
        seconds: how long all of it took, if that is known.
    """
    log = json.loads((out / "machine" / "diagnosis.json").read_text())
    took = "" if seconds is None else f", in {seconds / 60:.1f} minutes"
    returns_figure(arm.returns, out / "returns.png")
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>mpge_jax: a demonstration</title><link rel="icon" href="data:,"><style>{STYLE}</style></head><body><main>
<h1>mpge_jax: a demonstration{took}</h1>
{_concealed(arm)}
{_policies(arm, out)}
{_whole(out / "arm", "The arm, recorded and simulated")}
{_machine(log, out, machine)}
</main></body></html>
"""


def _concealed(arm: Simulated) -> str:
    hidden, found = arm.hidden, arm.found
    named = [e for e in found["effects"] if (e["id"], e["at"]) == (hidden.id, hidden.at)]
    entry = named[0]["parameters"][hidden.parameter] if named else None
    size = f"{hidden.value:g} {hidden.unit}".removesuffix(" 1")
    rows = [
        ["concealed", _name(hidden.id), escape(hidden.at), escape(size), ""],
        *(
            ["found", _name(e["id"]), escape(e["at"]), escape(quantity(p)), escape(intervals(p))]
            for e in found["effects"]
            for p in list(e["parameters"].values())[:1]
        ),
    ]
    verdict = (
        f"The diagnosis found it: {quantity(entry)}."
        if entry
        else f"The diagnosis did not name it; its verdict is {found['verdict']}."
    )
    return (
        f'<p class="lead">Concealed in a simulated arm: {escape(hidden.about)}, {escape(size)}. {escape(verdict)}</p>'
        "<p>It had six recordings of commands and joint angles, and the model without it. "
        f"{escape(found['explanation'])} The <a href='arm/report.html'>whole report</a> "
        "says what else it could have been.</p>" + table(["", "effect", "at", "size", "95 % interval"], rows)
    )


def _policies(arm: Simulated, out: Path) -> str:
    returns = {name: np.array(r["target"], float) for name, r in arm.returns.items()}
    blocks = "".join(
        f"<div><b>{r.mean():.1f} ± {r.std():.1f}</b>trained in the simulator {escape(name)}</div>"
        for name, r in returns.items()
    )
    return (
        '<div class="row"><div>'
        + image(out / "arm" / "figures" / "robot.png", "the arm with the place of what was found")
        + f"</div><div><h2>What that is worth to a policy</h2><div class='numbers'>{blocks}</div><p class='quiet'>"
        "Return in the arm with what is concealed: mean and standard deviation of 50 episodes. The most is 100, the "
        "hand held at a point for the whole of 4 s. Both policies learned by SAC from as many steps, neither in "
        "that arm.</p></div></div>"
        + image(out / "returns.png", "returns of both policies while they learn, and in the target")
    )


def _whole(folder: Path, title: str) -> str:
    figures = folder / "figures"
    if not (figures / "whole.png").exists():
        return ""
    parts = [
        f"<h2>{title}</h2><p class='quiet'>Whole recordings that nothing was fitted to.</p>",
        image(figures / "whole.png", "whole held-out recordings, predicted before and after"),
    ]
    if (figures / "strip.png").exists():
        parts.append(image(figures / "strip.png", "the machine at moments of one of them"))
    return "".join(parts)


def _machine(log: dict[str, Any], out: Path, machine: Path) -> str:
    held, unit = log["fit"]["held_out"], log["fit"]["unit"]
    rows = [[_name(e), *map(escape, rest)] for e, *rest in effect_rows(log)]
    more = f"<p>And {len(rows) - EFFECTS} more.</p>" if len(rows) > EFFECTS else ""
    head = ["effect", "at", "parameter", "value", "95 % interval", "held-out error without it"]
    return (
        f"<h1 style='margin-top:3rem'>A real arm: the log of a UR10 <span class='badge {log['verdict']}'>"
        f"{log['verdict']}</span></h1>"
        f"<p class='lead'>Held-out error of the torques: {held['before']:.3g} {unit} with the maker's model, "
        f"{held['after']:.3g} {unit} with what the diagnosis adds, {times(held['before'], held['after'])} less.</p>"
        "<div class='row'><div>"
        + image(out / "machine" / "figures" / "robot.png", "the UR10 with the places of what was found")
        + f"</div><div><p>{escape(log['explanation'])}</p></div></div>"
        + table(head, rows[:EFFECTS])
        + more
        + _whole(out / "machine", "The UR10's torques, measured and predicted")
        + "<p>The <a href='machine/report.html'>whole report</a>. 27.5 s of one recording, its last third held out. "
        "Source: unisa-acg/inverse-dynamics-solver, BSD 3-Clause (Petrone, Ferrentino, Chiacchio, IEEE Transactions on "
        f"Industrial Informatics, 2025); see <code>{escape('/'.join(machine.parts[-3:]))}/SOURCE.md</code>.</p>"
    )


def _name(effect: str) -> str:
    return escape(effect.replace("_", " "))
