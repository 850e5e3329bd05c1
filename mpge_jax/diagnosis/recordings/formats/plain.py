"""`.csv` files by the titles of a recording, and columns of `.csv` and `.npz` by other names that people use."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.column_map import UNITS, csv_places
from mpge_jax.diagnosis.recordings.formats import aliases
from mpge_jax.diagnosis.recordings.formats.arrays import KEYS, raw_columns
from mpge_jax.diagnosis.recordings.formats.csv_table import read_table
from mpge_jax.diagnosis.recordings.formats.tables import Column, Log, Table

SIZES = {unit: size for units in UNITS.values() for unit, size in units.items()}
"""Units that a title may name, with their sizes in SI units."""


def unit_of(title: str) -> tuple[str, str | None]:
    """A title without the unit that it names, and that unit."""
    return aliases.split_unit(title, SIZES)


def read_csv(
    path: Path, model: mujoco.MjModel, names: Names, renamed: Collection[str] = ()
) -> tuple[dict[str, np.ndarray], list[int]]:
    """Columns `time`, `qpos:JOINT`, `qvel:JOINT`, `ctrl:ACTUATOR`, `actuator_force:ACTUATOR` of a CSV file, and the
    line in which each row stands.

    A joint with several numbers has one column for each: `qpos:root:0` to `qpos:root:6`, `qvel:root:0` to
    `qvel:root:5`, and a title may name a unit: `qpos:elbow [deg]`. Titles that are `renamed` by a map are left to it.
    """
    header, table, lines = read_table(path, lambda title: title.partition(":")[0] in KEYS)
    out: dict[str, np.ndarray] = {}
    places = csv_places(model, names)
    for column, title in enumerate(header):
        bare, unit = unit_of(title)
        key, _, rest = bare.partition(":")
        if key not in KEYS or title in renamed:
            continue
        value = table[:, column] * SIZES.get(unit or "", 1.0)
        if bare == "time":
            out["time"] = value
            continue
        if (key, rest) not in places:
            known = ", ".join(n for k, n in places if k == key)
            raise InputError(f"{path.name}: column '{title}' names nothing in the model (known: {known}).")
        width = {"qpos": model.nq, "qvel": model.nv}.get(key, model.nu)
        array = out.setdefault(key, np.full((len(table), width), np.nan))
        array[:, places[key, rest]] = value
    return out, lines


def aliased_log(path: Path, every: bool = False) -> Log | None:
    """A run of the columns that have a known name (or `every` column of numbers), or None where there are none."""
    _, titles = raw_columns(path, set())
    csv = path.suffix.lower() == ".csv"
    groups = _grouped(titles, every) if csv else {t: {t: ""} for t in titles}
    found = {title: key for key, title in aliases.best(groups).items()}
    wanted = list(groups) if every else list(found)
    raw, _ = raw_columns(path, {t for title in wanted for t in groups[title]}, every)
    time, time_title, columns, unread = None, None, [], []
    for title in wanted:
        members = groups[title]
        if any(t not in raw or raw[t].dtype.kind not in "fiub" or raw[t].ndim not in (1, 2) for t in members):
            unread.append(title)
            continue
        sizes = [SIZES.get(unit_of(t)[1] or "", 1.0) for t in members]
        values = (
            np.stack([raw[t] * s for t, s in zip(members, sizes, strict=True)], axis=1) if csv else raw[title]
        )
        values = np.asarray(values if values.ndim == 2 else values[:, None], dtype=float)
        if csv and every and np.isnan(values).all():  # words
            unread.append(title)
            continue
        if found.get(title) == "time":
            time, time_title = values[:, 0], next(iter(members))
            continue
        named = csv and not all(p.isdigit() or not p for p in members.values())
        parts = tuple(members.values()) if named else None
        columns.append(Column(title, values, parts, found.get(title), titles=tuple(members) if csv else None))
    if not columns and time is None:
        return None
    table = Table("", tuple(columns), time, "its own times", time_title=time_title)
    return Log(path.stem, (table,), unread=tuple(unread))


def _grouped(titles: list[str], every: bool) -> dict[str, dict[str, str]]:
    """Array to the titles of its columns, each with the name of its part: `action[0]`, `action[1]` are one array."""
    out: dict[str, dict[str, str]] = {}
    for title in titles:
        bare, _ = unit_of(title)
        whole = (bare, "") if aliases.meaning(bare) else aliases.split_title(bare)
        if whole is None and every:
            whole = (title, "")
        if whole is not None and titles.count(title) == 1:
            out.setdefault(whole[0], {})[title] = whole[1]
    for members in out.values():
        if all(p.isdigit() for p in members.values()):
            ordered = sorted(members.items(), key=lambda m: int(m[1]))
            members.clear()
            members.update(ordered)
    return out
