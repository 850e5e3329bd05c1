"""Sections of the page that stand by themselves: what was given, and what to change in the model file."""

from __future__ import annotations

import base64
import datetime
import difflib
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from mpge_jax.diagnosis.estimation.whitening import column_scale
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.report.error_words import error_unit, moves, unit_of_motion
from mpge_jax.diagnosis.report.sentences import of_inputs
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.verdict.result import Result

RECORDINGS, LINES, LISTED = 40, 60, 12
"""Recordings, lines of the model file, and names in a sentence, that are shown at most."""

_TAG = {"-": "del", "+": "ins"}


def given(d: Result) -> str:
    """The section of the page."""
    p = d.prepared
    used = {"train": "training", "choice": "choosing effects", "test": "testing (held out)"}
    sources = [(s, what) for part, what in used.items() for s in getattr(p, part)]
    rows = [_row(s, part) for s, part in sources[:RECORDINGS]]
    more = f"<p>And {len(sources) - RECORDINGS} more.</p>" if len(sources) > RECORDINGS else ""
    noise = column_scale(p.noise, p.model)[: p.model.nv]
    joints = [
        [escape(p.names.joint_of_dof(p.model, dof)), f"{noise[dof]:.2g} {unit_of_motion(p.model, dof)}"]
        for dof in range(p.model.nv)
        if np.isfinite(noise[dof])
    ]
    name = d.model.name if d.model is not None else p.spec.modelname
    count = len({s.recording.log for s in p.sources})
    return (
        f"<h2>What it was given</h2><p>Model <code>{escape(name)}</code>; {count} "
        f"{'recording' if count == 1 else 'recordings'}; "
        f"report of {datetime.date.today().isoformat()}.</p>"
        + table(["recording", "used for", "lasts (s)", "rows a second", "rows"], rows)
        + more
        + table(["joint", "noise of its position (standard deviation)"], joints)
    )


def logs(sources: tuple[Source, ...]) -> str:
    """Names of the logs of which some recordings are parts; of many, the first ones."""
    return escape(", ".join(list(dict.fromkeys(s.recording.log for s in sources))[:LISTED]))


def _row(s: Source, part: str) -> list[str]:
    r = s.recording
    rate = 1.0 / float(np.median(np.diff(r.time)))
    rows = r.time.size - r.first_shown
    return [escape(r.log), part, f"{r.duration - s.spent:.3g}", f"{rate:.3g}", f"{rows}"]


def changes(nominal: str, corrected: str) -> list[str]:
    """Lines that the corrected model has in place of the nominal one's: each begins with '-' or '+'."""
    before, after = nominal.splitlines(), corrected.splitlines()
    lines = difflib.unified_diff(before, after, lineterm="", n=0)
    return [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]


def pasted(nominal: str, corrected: str) -> str:
    """The section of the page; nothing where the model file stays as it is."""
    lines = changes(nominal, corrected)
    if not lines:
        return ""
    shown = [f"<{_TAG[line[0]]}>{escape(line)}</{_TAG[line[0]]}>" for line in lines[:LINES]]
    more = [f"... and {len(lines) - LINES} more lines in corrected.xml"] if len(lines) > LINES else []
    return (
        "<h2>What to change in the model file</h2><p>Lines of <code>nominal.xml</code> (-) and what stands in their "
        f"place in <code>corrected.xml</code> (+):</p><pre>{chr(10).join(shown + more)}</pre>"
    )


def whole(d: Result, figures: dict[str, Path]) -> str:
    """Whole held-out recordings, where there is a figure of them."""
    if "whole" not in figures:
        return ""
    how = (
        "the forces that the whole recorded motion needs"
        if isinstance(d.held, ForceErrors)
        else "simulated from the first row to the last, never put back to what was measured"
    )
    return (
        f'<h2>Whole held-out recordings</h2><p class="quiet">Nothing was fitted to them; {how}.</p>'
        + image(figures["whole"], "whole held-out recordings, predicted before and after")
        + _strip(figures)
    )


def _strip(figures: dict[str, Path]) -> str:
    """The machine at moments of the first of these recordings."""
    if "strip" not in figures:
        return ""
    return (
        '<p class="quiet">The machine at moments of the first of them: grey as measured, the models over it.</p>'
        + image(figures["strip"], "the machine at moments of a held-out recording, measured and predicted")
    )


def residual(d: Result, figures: dict[str, Path]) -> str:
    """What is left as functions: formulas with what their letters mean, ranges, and how it does."""
    if d.residual is None:
        return ""
    items = [
        f"<li>{f.effect.what.capitalize()} at the {escape(f.term.place.name)}, as a function "
        f"{escape(of_inputs(f))}.</li>"
        for f in d.residual.functions
    ]
    unit = error_unit(d)
    return (
        "<h2>What is left, as a function</h2><p>Fitted to the other recordings; the points are the force that is "
        "missing in the held-out ones, told without it. With it the error of held-out recordings "
        f"{escape(moves(d.residual.before, d.residual.after, unit))}. <code>effects.json</code> holds it.</p>"
        f"<ul>{''.join(items)}</ul>"
        + image(
            figures["residual"],
            "the missing force over what it depends on, with the function that was fitted",
        )
    )


def inertias(factors: list[dict[str, Any]] | None) -> str:
    """The given masses and inertias, where they are off: `given_inertias` of `diagnosis.json`."""
    if factors is None:
        return ""
    rows = [
        [
            escape(body["at"]),
            *(
                f"{f['value']:.3g} ({f['low']:.3g} to {f['high']:.3g})"
                for f in (body["mass"], body["inertia"])
            ),
        ]
        for body in factors
    ]
    return (
        "<h2>Masses and inertias as given</h2><p>Nobody knows them exactly, so that this is no missing physics. Better "
        "than as given, with 95 % intervals:</p>" + table(["body", "mass, times", "inertia, times"], rows)
    )


def close(d: Result) -> str:
    """What the figure of short stretches shows."""
    if isinstance(d.held, ForceErrors):
        return "A few seconds, over time and over the joint's position: dry friction is a step where a joint turns."
    return "Pieces of usual difficulty, each predicted from an estimated state; the errors above are over such pieces."


def predicted(d: Result, table: dict[str, Any]) -> str:
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


def image(path: Path, alt: str) -> str:
    """A picture within the page itself."""
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{escape(alt, quote=True)}" src="data:image/png;base64,{data}">'


def table(head: list[str], rows: list[list[str]]) -> str:
    """HTML of a table. head: plain text. rows: cells as HTML."""
    top = "".join(f"<th>{escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="overflow"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
