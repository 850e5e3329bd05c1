"""`report.html`: one self-contained page that a person can forward."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from mpge_jax.diagnosis.estimation.quantities import intervals, quantity
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.report.error_words import beside_noise, makes_up, times, unit_of_joint
from mpge_jax.diagnosis.report.html_sections import (
    close,
    given,
    image,
    inertias,
    logs,
    pasted,
    predicted,
    residual,
    whole,
)
from mpge_jax.diagnosis.report.html_sections import table as table_of
from mpge_jax.diagnosis.report.sentences import effect_rows
from mpge_jax.diagnosis.report.style import STYLE
from mpge_jax.diagnosis.verdict.part_of_unknown import UNKNOWN
from mpge_jax.diagnosis.verdict.result import Result

ALIKE = "These explain the recordings equally well"
PART = "What was named where something acts that has no name may be a part of that"
FEW = 3
"""Effects that are listed by name beside those that are ambiguous."""
_WORDS = {
    "effects": "found",
    "none": "nothing missing",
    "ambiguous": "more than one explanation",
    "unexplained": "something unexplained",
}


def _number(value: float | None, unit: str = "") -> str:
    return "unknown" if value is None else escape(f"{value:.3g} {unit}".rstrip())


def _effects(table: dict[str, Any]) -> str:
    rows: list[list[str]] = []
    above: list[str] = []
    for row in effect_rows(table):
        effect, *rest = row
        shown = [effect.replace("_", " "), *rest]
        rows.append([escape(x) for x in (["", "", *shown[2:-1], ""] if row[:2] == above else shown)])
        above = row[:2]
    if not rows:
        return ""
    head = ["effect", "at", "parameter", "value", "95 % interval", "held-out error without it"]
    return "<h2>What the model lacks</h2>" + table_of(head, rows)


def _rivals(table: dict[str, Any]) -> str:
    rows = []
    for e in table["effects"]:
        for r in e.get("rivals", []):
            same = (r["id"], r["at"]) == (e["id"], e["at"])
            rows.append(
                [
                    escape(f"{e['id'].replace('_', ' ')} at {e['at']}"),
                    "another form of it" if same else escape(f"{r['id'].replace('_', ' ')} at {r['at']}"),
                    escape(r["why_not"]),
                ]
            )
    return (
        "<h2>What else it could have been</h2>" + table_of(["chosen", "instead", "why not"], rows)
        if rows
        else ""
    )


def _drives(d: Result) -> str:
    """Errors between commands and measured forces, where both were recorded."""
    if d.actuators is None or not d.actuators.errors:
        return ""
    rows = [[escape(a), f"{x:.3g}", f"{y:.3g}"] for a, (x, y) in d.actuators.errors.items()]
    return (
        "<h2>From command to measured force</h2><p>Root-mean-square error of the force that a command should give, "
        "on held-out recordings, in the units of <code>actuator_force</code>:</p>"
        + table_of(["actuator", "as given", "corrected"], rows)
    )


def _ambiguous(table: dict[str, Any], experiment: Mapping[str, object] | None) -> str:
    parts = []
    for entry in table["ambiguous"]:
        sets = [[(e["id"], e["at"]) for e in candidate] for candidate in entry["candidates"]]
        common = set(sets[0]).intersection(*sets)
        items = []
        for candidate in entry["candidates"]:
            names = []
            for e in candidate:
                if (e["id"], e["at"]) in common:
                    continue
                values = (f"{k} {quantity(v)}, 95 %: {intervals(v)}" for k, v in e["parameters"].items())
                shown = "; ".join(values)
                names.append(f"{e['id'].replace('_', ' ')} at {e['at']}" + (f" ({shown})" if shown else ""))
            items.append(f"<li>{escape(' and '.join(names))}</li>")
        beside = " and ".join(f"{i.replace('_', ' ')} at {at}" for i, at in sets[0] if (i, at) in common)
        beside = f"the {len(common)} other effects" if len(common) > FEW else beside
        beside = f", each beside {escape(beside)}" if beside else ""
        said = PART if any(name == UNKNOWN for name, _ in sets[-1]) else ALIKE
        parts.append(
            f"<p>{said}{beside}:</p><ul>{''.join(items)}</ul>"
            f"<p><b>To tell them apart:</b> {escape(entry['separated_by'])}.</p>"
        )
    if parts and experiment is not None:
        e = experiment
        parts.append(
            f"<p>A command sequence that separates them in simulation is in <code>{escape(str(e['path']))}</code>: "
            f"{escape(str(e['kind']))}, {e['seconds']:.1f} s, from rest in the pose that the file holds. In simulation "
            "no joint leaves the recorded range by more than half of it, nor is more than twice as fast. Look before "
            "you play it.</p>"
        )
    return "<h2>More than one explanation</h2>" + "".join(parts) if parts else ""


def _not_native(effects: dict[str, Any]) -> str:
    """What the model file cannot hold, of the contents of `effects.json`."""
    missing = [f"{e['id'].replace('_', ' ')} at {e['at']}" for e in effects["effects"] if not e["native"]]
    if not missing:
        return ""
    return (
        f"<p><code>corrected.xml</code> holds all but {escape(', '.join(missing))}, for which MuJoCo has no element; "
        "<code>effects.json</code> holds everything.</p>"
    )


def _unexplained(d: Result) -> str:
    u = d.unexplained
    if u is None:
        return ""
    recordings = [s.recording for s in d.prepared.sources]
    hidden = {r.name: r.origin - r.shown_origin for r in recordings}
    rows = [[escape(n), *(f"{t - hidden[n]:.2f}" for t in (a, b))] for n, a, b in u["intervals"]]
    return (
        f"<h2>What nothing explains</h2><p>At {escape(' and '.join(u['at']))}: {escape(u['when'])}. {makes_up(u)} Look "
        "at these moments:</p>" + table_of(["recording", "from (s)", "to (s)"], rows)
    )


def _next(d: Result) -> str:
    items = [
        f"<li>{escape(t.name.replace('_', ' '))} at {escape(t.place.name)}: {escape(t.effect.remedy)}.</li>"
        for t in d.terms
        if t.effect.remedy
    ]
    if not items:
        return ""
    return (
        "<h2>What to record next</h2><p>To confirm and sharpen what was found:</p><ul>"
        + "".join(items)
        + "</ul>"
    )


def page(
    d: Result,
    table: dict[str, Any],
    effects: dict[str, Any],
    figures: dict[str, Path],
    experiment: Mapping[str, object] | None = None,
    models: tuple[str, str] = ("", ""),
) -> str:
    """The whole page; everything that comes from the model or the recordings is escaped.

    Args:
        table, effects: the contents of `diagnosis.json` and of `effects.json`. experiment: what
            `next_experiment.design` found. models: `nominal.xml` and `corrected.xml`.
    """
    held = table["fit"]["held_out"]
    first, _, rest = table["explanation"].partition(". ")
    lead = first if first.endswith(".") else first + "."
    unit = table["fit"]["unit"]
    before, after = (_number(held[k], unit) for k in ("before", "after"))
    changed = bool(held["before"] and held["after"] and held["before"] != held["after"])
    gain = times(held["before"], held["after"]) if changed else ""
    way = "smaller" if changed and held["after"] < held["before"] else "larger"
    moves = not isinstance(d.held, ForceErrors)
    noise = beside_noise(held["after"], held["noise_floor"], unit, moves) if held["after"] else ""
    columns = ["joint", "as given", *(["corrected"] if changed else [])]
    joints = [
        [escape(f"{name} ({unit_of_joint(d, name)})"), *map(_number, errors)][: len(columns)]
        for name, errors in held["per_joint"].items()
    ]
    warnings = "".join(f"<li>{escape(w)}</li>" for w in table["warnings"])
    versions = ", ".join(f"{escape(k)} {escape(v)}" for k, v in table["versions"].items())
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Mismatch diagnosis</title><link rel="icon" href="data:,"><style>{STYLE}</style></head><body><main>
<h1>Mismatch diagnosis <span class="badge {table["verdict"]}">{_WORDS[table["verdict"]]}</span></h1>
<p class="lead">{escape(lead)}</p><p>{escape(rest)}</p>
{'<div class="warnings"><b>Take note:</b><ul>' + warnings + "</ul></div>" if warnings else ""}
<div class="row"><div>{image(figures["robot"], "the machine with the place marked")}</div>
<div><h2>On recordings that nothing was fitted to</h2><div class="numbers"><div><b>{before}</b>model as given</div>
{f"<div><b>{after}</b>corrected model</div><div><b>{gain}</b>{way} error</div>" if changed else ""}</div>
<p class="quiet">Root-mean-square error of {predicted(d, table)}, over {len(held["recordings"])} held-out
{"recording" if len(held["recordings"]) == 1 else "recordings"}; {escape(noise)}.</p>
{table_of(columns, joints)}</div></div>
{_effects(table)}{inertias(table["given_inertias"])}{_ambiguous(table, experiment)}{_unexplained(d)}
{residual(d, figures)}{whole(d, figures)}{_drives(d)}
{pasted(*models)}{_not_native(effects)}
<h2>Closer</h2><p class="quiet">{close(d)}</p>
{image(figures["prediction"], "held-out motion, predicted before and after")}
<div class="row"><div>{image(figures["errors"], "errors by joint")}</div>
<div>{image(figures["location"], "where force is missing")}</div></div>
<h2>Where the error lies in time</h2>{image(figures["residuals"], "error by window")}
{_rivals(table)}{_next(d)}{given(d)}
<p><small>Trained on {logs(d.prepared.looked_at)}; held out {logs(d.prepared.test)}. Seed {table["seed"]};
{versions}.</small></p>
</main></body></html>
"""
