"""An overview in words, for a terminal."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.inspection.overview import Clock, Overview
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.formats.tables import Column

SHOWN = 40
"""Columns that are listed one by one."""


def summary(o: Overview, names: Names) -> str:
    """What was found, how it is read, and what looks wrong."""
    lines = [f"{o.log.name} ({o.format})", *map(_clock, o.clocks), "", *_columns(o)]
    lines += ["", *_not_found(o, names)]
    for title, texts in (("looks wrong", o.doubts), ("take note", o.notes)):
        if texts:
            lines += ["", f"{title}:", *(f"  - {text}" for text in texts)]
    if o.log.unread:
        lines += ["", f"not read: {', '.join(o.log.unread)}"]
    lines += ["", _verdict(o)]
    return "\n".join(lines)


def _clock(c: Clock) -> str:
    name = c.table or "rows"
    if c.step is None or c.step <= 0:
        return (
            f"  {name}: {c.rows} rows without times"
            if c.step is None
            else f"  {name}: {c.rows} rows, all at one time"
        )
    least, most = _ms(c.least), _ms(c.most)
    even = f"steps of {least} ms" if least == most else f"steps of {least} to {most} ms"
    if c.words == "frame_index / fps":
        even = "even by definition"
    gaps = f", {c.gaps} gaps" if c.gaps else ", no gaps"
    back = f", {c.back} rows not later than the one before" if c.back else ""
    return f"  {name}: {c.rows} rows in {c.duration:.4g} s, {1 / c.step:.4g} a second by {c.words}, {even}{gaps}{back}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.4g}"


def _columns(o: Overview) -> list[str]:
    """A line a column: what it holds, and what it is read as."""
    found = o.found
    read_as = {(id(c), i): target for target, (c, i) in found.items()}
    rows = [("column", "part", "least", "largest", "read as")]
    for table in o.log.tables:
        for c in table.columns:
            rows += [(*_column(c, i), read_as.get((id(c), i), "")) for i in range(c.values.shape[1])]
    shown = rows[: SHOWN + 1]
    widths = [max(len(r[k]) for r in shown) for k in range(4)]
    out = [
        "  " + "  ".join(text.ljust(w) for text, w in zip(r, (*widths, 0), strict=True)).rstrip()
        for r in shown
    ]
    return out + ([f"  ... and {len(rows) - 1 - SHOWN} more"] if len(rows) > SHOWN + 1 else [])


def _column(c: Column, i: int) -> tuple[str, str, str, str]:
    value = c.values[:, i][np.isfinite(c.values[:, i])]
    part = c.parts[i] if c.parts else (str(i) if c.values.shape[1] > 1 else "")
    if not value.size:
        return c.title, part, "none", ""
    return c.title, part, f"{value.min():.4g}", f"{value.max():.4g}" if np.ptp(value) > 0 else "never changes"


def _not_found(o: Overview, names: Names) -> list[str]:
    """Joints and actuators of which nothing was found, by what was looked for."""
    found, out = o.found, []
    for key, word in (
        ("qpos", "positions"),
        ("qvel", "velocities"),
        ("ctrl", "commands"),
        ("actuator_force", "forces"),
    ):
        wanted = names.joints if key in ("qpos", "qvel") else names.actuators
        lacking = [
            w for w in wanted if not any(t == f"{key}:{w}" or t.startswith(f"{key}:{w}:") for t in found)
        ]
        if lacking:
            out.append(
                f"  {word}: none" if len(lacking) == len(wanted) else f"  {word} of {', '.join(lacking)}"
            )
    return ["not found:", *out] if out else ["everything was found."]


def _verdict(o: Overview) -> str:
    if o.recording is None:
        return f"It cannot be diagnosed as it is: {o.problem}"
    r = o.recording
    first = ", once what looks wrong is put right" if o.doubts else ""
    return f"It can be diagnosed{first}: {r.time.size} rows, {r.duration:.4g} s."
