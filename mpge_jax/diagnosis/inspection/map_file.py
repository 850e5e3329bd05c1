"""A map to start from: every line that was given or recognised, and what is left to be said."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence

import mujoco

from mpge_jax.diagnosis.inspection.doubts import Doubt
from mpge_jax.diagnosis.inspection.overview import Overview
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.column_map import csv_places
from mpge_jax.diagnosis.recordings.formats.plain import unit_of
from mpge_jax.diagnosis.recordings.formats.tables import Column


def map_text(
    overview: Overview, model: mujoco.MjModel, names: Names, doubted: Sequence[Doubt] | None = None
) -> str:
    """The file as YAML, which `column_map.load` reads.

    Args:
        doubted: what looks wrong in any run, if not in this one alone; units that would put it right are in the file.
    """
    found = overview.found
    doubted = overview.doubted if doubted is None else doubted
    units = {target: (unit, text) for text, of in reversed(doubted) for target, unit in of.items()}
    lines = [
        "# Which column of the log is what. Correct it, and give it to the diagnosis with --map.",
        "# Entries: from, column (number or name), unit (deg, rad, mm, m, rpm, deg/s, ms, N m ...), scale, offset.",
        "# The log has:",
        *(f"#   {_named(c)}" for table in overview.log.tables for c in table.columns),
        "columns:",
        *_time(overview, units),
    ]
    for key in ("qpos", "qvel", "ctrl", "actuator_force"):
        wanted = [f"{k}:{name}" for k, name in csv_places(model, names) if k == key]
        # a key that a map names is read from the map alone, so that none is named in part
        some = any(target in found for target in wanted)
        for target in wanted:
            if target in overview.given:
                lines.append(_line(target, overview.given[target], units))
            elif target in found:
                lines.append(_line(target, _entry(*found[target]), units))
            else:
                lines.append(f"  # {json.dumps(target)}: {{from: ?}}" + ("" if some else "  # not found"))
    return "\n".join(lines) + "\n"


def _line(target: str, entry: object, units: Mapping[str, tuple[str, str]]) -> str:
    """A column's line; with the unit that it seems to be in, and why, where it would look wrong without."""
    parts = entry if isinstance(entry, Mapping) else {"from": entry}
    said, remark = [f"{key}: {json.dumps(value)}" for key, value in parts.items()], ""
    if target in units and "unit" not in parts:
        unit, why = units[target]
        said.append(f"unit: {unit}")
        remark = f"  # {' '.join(why.split())}"
    name = "time" if target == "time" else json.dumps(target)
    return f"  {name}: {{{', '.join(said)}}}{remark}"


def _entry(column: Column, part: int) -> dict[str, object]:
    if column.titles is not None:
        title, (_, unit) = column.titles[part], unit_of(column.titles[part])
        return {"from": title, "unit": unit} if unit else {"from": title}
    if column.values.shape[1] == 1:
        return {"from": column.title}
    name = column.parts[part] if column.parts and column.parts.count(column.parts[part]) == 1 else part
    return {"from": column.title, "column": name}


def _time(overview: Overview, units: Mapping[str, tuple[str, str]]) -> Iterable[str]:
    if "time" in overview.given:
        return [_line("time", overview.given["time"], units)]
    tables = (overview.joined.base,) if overview.joined else overview.log.tables
    base = tables[0] if tables else None
    if base is not None and base.time_title is not None and "time" in units:
        return [_line("time", {"from": base.time_title}, units)]
    if base is None or base.time is None:
        return ["  # time: {step: 0.02}  # seconds from row to row, where the log has no times"]
    return [f"  # time: {base.clock}; another column: {{from: ?}}; even steps: {{step: 0.02}}"]


def _named(column: Column) -> str:
    """A column and its parts, on one line of a comment."""
    if column.values.shape[1] == 1:
        return " ".join(column.title.split())
    parts = column.titles or column.parts or (f"{column.values.shape[1]} parts",)
    return " ".join(f"{column.title} [{', '.join(parts)}]".split())
