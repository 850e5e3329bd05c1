"""Sections of the page that stand by themselves: what was given, and what to change in the model file."""

from __future__ import annotations

import datetime
import difflib
from html import escape

import numpy as np

from mpge_jax.diagnosis.estimation.whitening import column_scale
from mpge_jax.diagnosis.report.sentences import unit_of_motion
from mpge_jax.diagnosis.simulation.drive_signal import Source
from mpge_jax.diagnosis.verdict.result import Result

RECORDINGS, LINES = 40, 60
"""Recordings, and lines of the model file, that are shown at most."""


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
    return (
        f"<h2>What it was given</h2><p>Model <code>{escape(p.spec.modelname)}</code>; {len(sources)} recordings; "
        f"report of {datetime.date.today().isoformat()}.</p>"
        + table(["recording", "used for", "lasts (s)", "rows a second", "rows"], rows)
        + more
        + table(["joint", "noise of its position (standard deviation)"], joints)
    )


def _row(s: Source, part: str) -> list[str]:
    r = s.recording
    rate = 1.0 / float(np.median(np.diff(r.time)))
    return [escape(r.name), part, f"{r.duration:.3g}", f"{rate:.3g}", f"{r.time.size}"]


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
    more = f"\n... and {len(lines) - LINES} more lines in corrected.xml" if len(lines) > LINES else ""
    return (
        "<h2>What to change in the model file</h2><p>Lines of <code>nominal.xml</code> (-) and what stands in their "
        f"place in <code>corrected.xml</code> (+):</p><pre>{escape(chr(10).join(lines[:LINES]) + more)}</pre>"
    )


def table(head: list[str], rows: list[list[str]]) -> str:
    """HTML of a table. head: plain text. rows: cells as HTML."""
    top = "".join(f"<th>{escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="overflow"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
