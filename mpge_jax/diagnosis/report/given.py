"""What a diagnosis was given: model, recordings and the noise of their sensors, as HTML."""

from __future__ import annotations

import datetime
from html import escape

import numpy as np

from mpge_jax.diagnosis.estimation.whitening import column_scale
from mpge_jax.diagnosis.report.html_table import table
from mpge_jax.diagnosis.report.sentences import unit_of_motion
from mpge_jax.diagnosis.simulation.drive_signal import Source
from mpge_jax.diagnosis.verdict.result import Result

MOST = 40
"""Recordings that are listed."""


def given(d: Result) -> str:
    """The section of the page."""
    p = d.prepared
    sources = [(s, "training") for s in p.train_sources] + [(s, "held out") for s in p.held_sources]
    rows = [_row(s, part) for s, part in sources[:MOST]]
    more = f"<p>And {len(sources) - MOST} more.</p>" if len(sources) > MOST else ""
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
