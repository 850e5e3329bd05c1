"""`report.html`: one self-contained page that a person can forward."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from mpge_jax.diagnosis.estimation.quantities import intervals, quantity
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.report.html_sections import given, pasted
from mpge_jax.diagnosis.report.html_sections import table as table_of
from mpge_jax.diagnosis.report.sentences import beside_noise, times, unit_of_joint, worse_without
from mpge_jax.diagnosis.verdict.result import Result

_STYLE = """
:root{color-scheme:light}
body{font:16px/1.5 system-ui,sans-serif;color:#1b1b1b;background:#fff;margin:0}
main{max-width:60rem;margin:0 auto;padding:2rem 1.25rem 4rem}
h1{font-size:1.15rem;color:#555;margin:0 0 .5rem;font-weight:600}
.lead{font-size:1.45rem;line-height:1.35;margin:.2rem 0 1.2rem;font-weight:600}
h2{font-size:1.15rem;margin:2.2rem 0 .6rem}
.badge{display:inline-block;padding:.1rem .6rem;border-radius:1rem;color:#fff;font-size:.85rem;font-weight:600}
.effects{background:#1f6fb2}
.none{background:#2d7d46}
.ambiguous{background:#9a6700}
.unexplained{background:#b3261e}
table{border-collapse:collapse;width:100%;font-size:.94rem}
th,td{text-align:left;padding:.35rem .7rem .35rem 0;border-bottom:1px solid #ddd;vertical-align:top}
img{max-width:100%;height:auto}
pre{overflow-x:auto;background:#f4f4f4;padding:.6rem .8rem;font-size:.85rem}
.row{display:flex;flex-wrap:wrap;gap:1.5rem;align-items:flex-start}
.row>*{flex:1 1 20rem}
.numbers{display:flex;flex-wrap:wrap;gap:1.2rem;margin:.6rem 0 1rem}
.numbers div{min-width:8rem}
.numbers b{display:block;font-size:1.35rem}
small,.quiet{color:#555}
.warnings{border-left:.25rem solid #9a6700;padding:.1rem 0 .1rem .9rem;margin:1rem 0}
.warnings ul{margin:.2rem 0;padding-left:1.1rem}
.overflow{overflow-x:auto}
"""
_WORDS = {
    "effects": "found",
    "none": "nothing missing",
    "ambiguous": "more than one explanation",
    "unexplained": "something unexplained",
}


def _image(path: Path, alt: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{escape(alt, quote=True)}" src="data:image/png;base64,{data}">'


def _number(value: float | None, unit: str = "") -> str:
    return "unknown" if value is None else escape(f"{value:.3g} {unit}".rstrip())


def _effects(table: dict[str, Any]) -> str:
    rows = []
    for e in table["effects"]:
        drop = e.get("error_drop")
        share = "" if drop is None else worse_without(drop)
        parameters = e["parameters"] or {"": {"value": None}}
        for i, (name, entry) in enumerate(parameters.items()):
            first = [escape(e["id"].replace("_", " ")), escape(e["at"])] if i == 0 else ["", ""]
            value = escape(quantity(entry)) if name else ""
            rows.append(
                [
                    *first,
                    escape(name),
                    value,
                    escape(intervals(entry)) if name else "",
                    share if i == 0 else "",
                ]
            )
    if not rows:
        return ""
    head = ["effect", "at", "parameter", "value", "95 % interval", "held-out error without it"]
    return "<h2>What the model lacks</h2>" + table_of(head, rows)


def _rivals(table: dict[str, Any]) -> str:
    rows = []
    for e in table["effects"]:
        for r in e.get("rivals", []):
            rows.append(
                [
                    escape(f"{e['id'].replace('_', ' ')} at {e['at']}"),
                    escape(f"{r['id'].replace('_', ' ')} at {r['at']}"),
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
        beside = f", each beside {escape(beside)}" if beside else ""
        parts.append(
            f"<p>These explain the recordings equally well{beside}:</p><ul>{''.join(items)}</ul>"
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
        f"<h2>What nothing explains</h2><p>At {escape(' and '.join(u['at']))}: {escape(u['when'])}. It makes up "
        f"{100 * u['share']:.0f} % of the squared error of the {u['of']} that the model as given predicts. Look at "
        "these moments:</p>" + table_of(["recording", "from (s)", "to (s)"], rows)
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


def _predicted(d: Result, table: dict[str, Any]) -> str:
    """What the errors are errors of."""
    if isinstance(d.held, ForceErrors):
        return f"the actuator forces that the recorded motion needs, by inverse dynamics{_resolved(d.held)}"
    return f"predicting the motion over windows of {table['fit']['window_s']:.2g} s, open loop"


def _resolved(e: ForceErrors) -> str:
    """How finely motion and force were compared, where that is less than as recorded."""
    r = e.balance.resolution
    parts = [
        text
        for text, value in (
            (f"of motion below {r.motion:.2g} Hz", r.motion),
            (f"as a sensor shows them that follows {r.sensor:.2g} Hz", r.sensor),
        )
        if np.isfinite(value)
    ]
    return f" ({', '.join(parts)})" if parts else ""


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
    noise = beside_noise(held["after"], held["noise_floor"], unit) if held["after"] else ""
    joints = [
        [escape(f"{name} ({unit_of_joint(d, name)})"), _number(a), _number(b)]
        for name, (a, b) in held["per_joint"].items()
    ]
    warnings = "".join(f"<li>{escape(w)}</li>" for w in table["warnings"])
    versions = ", ".join(f"{escape(k)} {escape(v)}" for k, v in table["versions"].items())
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Mismatch diagnosis</title><link rel="icon" href="data:,"><style>{_STYLE}</style></head><body><main>
<h1>Mismatch diagnosis <span class="badge {table["verdict"]}">{_WORDS[table["verdict"]]}</span></h1>
<p class="lead">{escape(lead)}</p><p>{escape(rest)}</p>
{'<div class="warnings"><b>Take note:</b><ul>' + warnings + "</ul></div>" if warnings else ""}
<div class="row"><div>{_image(figures["robot"], "the machine with the place marked")}</div>
<div><h2>On recordings that nothing was fitted to</h2><div class="numbers"><div><b>{before}</b>model as given</div>
{f"<div><b>{after}</b>corrected model</div><div><b>{gain}</b>{way} error</div>" if changed else ""}</div>
<p class="quiet">Root-mean-square error of {_predicted(d, table)}, over {len(held["recordings"])} held-out
{"recording" if len(held["recordings"]) == 1 else "recordings"}; {escape(noise)}.</p>
{table_of(["joint", "as given", "corrected"], joints)}</div></div>
{_effects(table)}{pasted(*models)}{_not_native(effects)}{_drives(d)}{_ambiguous(table, experiment)}{_unexplained(d)}
<h2>Prediction against measurement</h2>{_image(figures["prediction"], "held-out motion, predicted before and after")}
<div class="row"><div>{_image(figures["errors"], "errors by joint")}</div>
<div>{_image(figures["location"], "where force is missing")}</div></div>
<h2>Where the error lies in time</h2>{_image(figures["residuals"], "error by window")}
{_rivals(table)}{_next(d)}{given(d)}
<p><small>Trained on {escape(", ".join(table["fit"]["train"]["recordings"][:12]))}; held out
{escape(", ".join(held["recordings"][:12]))}. Seed {table["seed"]}; {versions}.</small></p>
</main></body></html>
"""
