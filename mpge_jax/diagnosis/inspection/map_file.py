"""A map to start from: every line that was given or recognised, and what is left to be said."""

from __future__ import annotations

import json
from collections.abc import Iterable

import mujoco

from mpge_jax.diagnosis.inspection.overview import Overview
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.column_map import csv_places
from mpge_jax.diagnosis.recordings.formats.tables import Column


def map_text(overview: Overview, model: mujoco.MjModel, names: Names) -> str:
    """The file as YAML, which `column_map.load` reads."""
    found = overview.found
    lines = [
        "# Which column of the log is what. Correct it, and give it to the diagnosis with --map.",
        "# Entries: from, column (number or name), unit (deg, rad, mm, m, rpm, deg/s, ms, N m ...), scale, offset.",
        "# The log has:",
        *(f"#   {_named(c)}" for table in overview.log.tables for c in table.columns),
        "columns:",
        *_time(overview),
    ]
    for key in ("qpos", "qvel", "ctrl", "actuator_force"):
        wanted = [f"{k}:{name}" for k, name in csv_places(model, names) if k == key]
        # a key that a map names is read from the map alone, so that none is named in part
        some = any(target in found for target in wanted)
        for target in wanted:
            if target in overview.given:
                lines.append(f"  {json.dumps(target)}: {json.dumps(overview.given[target])}")
            elif target in found:
                lines.append(f"  {json.dumps(target)}: {_entry(*found[target])}")
            else:
                lines.append(f"  # {json.dumps(target)}: {{from: ?}}" + ("" if some else "  # not found"))
    return "\n".join(lines) + "\n"


def _entry(column: Column, part: int) -> str:
    if column.titles is not None:
        return f"{{from: {json.dumps(column.titles[part])}}}"
    entry = f"from: {json.dumps(column.title)}"
    if column.values.shape[1] > 1:
        name = column.parts[part] if column.parts and column.parts.count(column.parts[part]) == 1 else part
        entry += f", column: {json.dumps(name)}"
    return f"{{{entry}}}"


def _time(overview: Overview) -> Iterable[str]:
    if "time" in overview.given:
        return [f"  time: {json.dumps(overview.given['time'])}"]
    base = overview.joined.base if overview.joined else None
    if base is None or base.time is None:
        return ["  # time: {step: 0.02}  # seconds from row to row, where the log has no times"]
    return [f"  # time: {base.clock}; another column: {{from: ?}}; even steps: {{step: 0.02}}"]


def _named(column: Column) -> str:
    """A column and its parts, on one line of a comment."""
    if column.values.shape[1] == 1:
        return " ".join(column.title.split())
    parts = column.titles or column.parts or (f"{column.values.shape[1]} parts",)
    return " ".join(f"{column.title} [{', '.join(parts)}]".split())
