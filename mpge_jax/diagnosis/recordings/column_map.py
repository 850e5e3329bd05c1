"""Rename and convert columns before a recording is read: the file given with `--map`.

    columns:                       # key of the recording -> what the file calls it
      time: {from: t, scale: 1.0e-3}
      qpos:shoulder: {from: q_shoulder_deg, unit: deg, offset: 0.0}
      ctrl:tau1: {from: command, column: 0}
      qvel:shoulder: {from: /joint_states/velocity, column: shoulder_joint}

`from` is a title of the log: of a CSV column, of an array, or of a field of a topic (with `column`, a number from 0 or
the name of the part, where it has several); the value read is `scale * x + offset`, and `unit: deg` stands for scale
pi/180. A unit must be one of what the column holds. Where a log has no times, `time: {step: 0.02}` makes them.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.formats.arrays import raw_columns

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "angle": {"rad": 1.0, "deg": np.pi / 180},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "angular velocity": {"rad/s": 1.0, "deg/s": np.pi / 180, "rpm": np.pi / 30},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "force": {"N": 1.0, "kN": 1e3},
    "torque": {"N m": 1.0, "N mm": 1e-3, "kN m": 1e3},
}
"""Units by what they measure, each with its size in SI units."""
_KEYS = ("from", "column", "unit", "scale", "offset")
_STEP_KEYS = ("step", "unit")
MOST_BYTES = 1 << 18
"""Most bytes of a map."""
Lookup = Callable[[str, str], tuple[np.ndarray, Sequence[str] | None] | None]
"""A title and the key that it is for, to its values [T] or [T, n] and the names of its parts."""


class _Plain(yaml.SafeLoader):
    """Plain data without aliases, by which a few lines may stand for more than fits into a message, or the memory."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.composer.ComposerError(None, None, "aliases are not read", mark)
        return super().compose_node(parent, index)


def load(path: Path) -> dict[str, Any]:
    """Read a mapping file (YAML, or JSON, which is YAML too)."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"the map {path.name} is larger than {MOST_BYTES >> 10} KB, which no map is.")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the map {path}: {error}.") from None
    try:
        data = yaml.load(text, _Plain)  # a SafeLoader
    except RecursionError:
        raise InputError(
            f"the map {path.name} is nested too deeply; a map has one line per column."
        ) from None
    except (yaml.YAMLError, ValueError) as error:  # dates that are none
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" (line {mark.line + 1}, column {mark.column + 1})"
        raise InputError(f"the map {path.name} is not valid YAML{where}; correct it.") from None
    if isinstance(data, dict) and "columns" in data and data["columns"] is None:
        return {}  # a map in which every line is a comment yet
    if not isinstance(data, dict) or not isinstance(data.get("columns"), dict):
        raise InputError(f"{path.name}: a map needs an entry 'columns' with one line per column.")
    return data["columns"]


def content(given: Mapping[str, Any] | str | Path | None) -> Mapping[str, Any] | None:
    """The entries of a map by column, however it is given: a file, what such a file holds, or the entries themselves.

    Raises:
        InputError: it is none of these, or the file cannot be used.
    """
    if given is None:
        return None
    if isinstance(given, str | Path):
        return load(Path(given))
    if not isinstance(given, Mapping):
        raise InputError(
            f"a map of columns is a file or a dict such as {{'qpos:elbow': {{'from': 'angle', 'unit': 'deg'}}}}, not "
            f"{type(given).__name__}."
        )
    inner = given.get("columns")
    return inner if isinstance(inner, Mapping) and "from" not in inner else given


def csv_places(model: mujoco.MjModel, names: Names) -> dict[tuple[str, str], int]:
    places: dict[tuple[str, str], int] = {}
    for j, joint in enumerate(names.joints):
        for key, start, total, table in (
            ("qpos", int(model.jnt_qposadr[j]), model.nq, model.jnt_qposadr),
            ("qvel", int(model.jnt_dofadr[j]), model.nv, model.jnt_dofadr),
        ):
            end = int(table[j + 1]) if j + 1 < model.njnt else total
            for i in range(start, end):
                places[key, joint if end - start == 1 else f"{joint}:{i - start}"] = i
    for a, actuator in enumerate(names.actuators):
        places["ctrl", actuator] = a
        places["actuator_force", actuator] = a
    return places


def sources(columns: Mapping[str, Any]) -> set[str]:
    """What the file calls the columns that a map reads."""
    entries = [{"from": entry} if isinstance(entry, str) else entry for entry in columns.values()]
    return {str(entry["from"]) for entry in entries if isinstance(entry, dict) and "from" in entry}


def apply(
    path: Path, data: dict[str, np.ndarray], columns: Mapping[str, Any], model: mujoco.MjModel, names: Names
) -> dict[str, np.ndarray]:
    """Add the mapped columns of a CSV or npz file to what was read from it.

    Raises:
        InputError: an entry names nothing in the file or in the model, or is malformed.
    """
    raw, titles = raw_columns(path, sources(columns))

    def look(title: str, _key: str) -> tuple[np.ndarray, None] | None:
        return (raw[title], None) if title in raw else None

    return apply_to(path.name, look, titles, data, columns, model, names)


def apply_to(
    log: str,
    look: Lookup,
    titles: Sequence[str],
    data: Mapping[str, np.ndarray],
    columns: Mapping[str, Any],
    model: mujoco.MjModel,
    names: Names,
) -> dict[str, np.ndarray]:
    """Add the mapped columns of any log to what was read from it.

    Args:
        log: its name in messages. look: gives its columns. titles: those that it has, for messages.

    Raises:
        InputError: an entry names nothing in the log or in the model, or is malformed.
    """
    places, out = csv_places(model, names), dict(data)
    widths = {"qpos": model.nq, "qvel": model.nv, "ctrl": model.nu, "actuator_force": model.nu}
    for target, entry in columns.items():
        entry = {"from": entry} if isinstance(entry, str) else entry
        if target == "time" and isinstance(entry, dict) and "step" in entry:
            continue
        if not isinstance(entry, dict) or "from" not in entry:
            raise InputError(f"map: '{target}' needs 'from' (what the file calls it).")
        _check_keys(str(target), entry, _KEYS)
        key, _, rest = str(target).partition(":")
        if target != "time" and (key, rest) not in places:
            known = [f"{k}:{name}" for k, name in places]
            raise InputError(
                f"map: '{target}' names nothing in the model{_nearest(str(target), known)} (known: time, "
                f"{', '.join(known)})."
            )
        value = _value(log, look, titles, str(target), entry)
        size = 1.0 if "unit" not in entry else _size(str(target), str(entry["unit"]), model, names)
        try:
            value = value * size * float(entry.get("scale", 1.0)) + float(entry.get("offset", 0.0))
        except (TypeError, ValueError):
            raise InputError(f"map: scale and offset of '{target}' must be numbers.") from None
        if target == "time":
            out["time"] = value
            continue
        array = out.get(key)
        if array is None or array.shape != (value.size, widths[key]):
            array = np.full((value.size, widths[key]), np.nan)
        out[key] = np.array(array, dtype=float)
        out[key][:, places[key, rest]] = value
    return _with_steps(out, columns.get("time"), model, names)


def _check_keys(target: str, entry: Mapping[str, Any], known: Sequence[str]) -> None:
    for key in map(str, entry):
        if key not in known:
            raise InputError(
                f"map: '{target}' has the unknown entry '{key}'{_nearest(key, known)} (known: {', '.join(known)})."
            )


def _value(
    log: str, look: Lookup, titles: Sequence[str], target: str, entry: Mapping[str, Any]
) -> np.ndarray:
    """The column [T] that an entry names."""
    title = str(entry["from"])
    found = look(title, target.partition(":")[0])
    if found is None:
        raise InputError(f"{log}: the map's '{title}' is not in the file (it has {', '.join(titles)}).")
    raw, parts = found
    if raw.dtype.kind not in "fiub":
        raise InputError(f"{log}: the map's '{title}' does not hold plain numbers.")
    value = np.asarray(raw, dtype=float)
    if value.ndim not in (1, 2):
        raise InputError(
            f"{log}: the map's '{title}' has {value.ndim} dimensions; columns have one, tables two."
        )
    if value.ndim == 1:
        return value
    column = entry.get("column", 0)
    if isinstance(column, str) and parts is not None:
        if column not in parts:
            raise InputError(
                f"map: '{target}' needs one of {', '.join(parts)} as its column{_nearest(column, parts)}."
            )
        column = list(parts).index(column)
    if not isinstance(column, int) or not 0 <= column < value.shape[1]:
        raise InputError(f"map: '{target}' needs a column between 0 and {value.shape[1] - 1}.")
    return value[:, column]


def _with_steps(
    data: dict[str, np.ndarray], entry: Any, model: mujoco.MjModel, names: Names
) -> dict[str, np.ndarray]:
    """Times that are even by a map's word, where the log has none."""
    if not isinstance(entry, dict) or "step" not in entry:
        return data
    _check_keys("time", entry, _STEP_KEYS)
    size = _size("time", str(entry.get("unit", "s")), model, names)
    try:
        step = float(entry["step"]) * size
    except (TypeError, ValueError):
        step = np.nan
    if not 0 < step < np.inf:
        raise InputError("map: 'step' of 'time' must be a positive number: the time from row to row.")
    rows = max((len(v) for v in data.values()), default=0)
    return {**data, "time": step * np.arange(rows)}


def _nearest(word: str, known: Sequence[str]) -> str:
    """', did you mean ...?' where one of the known words looks like it."""
    close = difflib.get_close_matches(word, known, 1)
    return f"; did you mean '{close[0]}'?" if close else ""


def _size(target: str, unit: str, model: mujoco.MjModel, names: Names) -> float:
    """The size of a unit in SI units; it must be one of what the column `target` holds."""
    kinds = _measures(target, model, names)
    known = {name: size for kind in kinds for name, size in UNITS[kind].items()}
    if unit not in known:
        what = " or ".join(kinds)
        raise InputError(f"map: '{unit}' of '{target}' is no unit of {what} (known: {', '.join(known)}).")
    return known[unit]


def _measures(target: str, model: mujoco.MjModel, names: Names) -> list[str]:
    """What a column may measure; a command anything but time."""
    key, _, rest = target.partition(":")
    if key == "time":
        return ["time"]
    if key == "ctrl":
        return [kind for kind in UNITS if kind != "time"]
    if key == "actuator_force":
        return ["force", "torque"]
    joint = rest if rest in names.joints else rest.rpartition(":")[0]
    kind, number = int(model.jnt_type[names.joints.index(joint)]), rest.rpartition(":")[2]
    linear = kind == mujoco.mjtJoint.mjJNT_SLIDE or (kind == mujoco.mjtJoint.mjJNT_FREE and int(number) < 3)
    if key == "qvel":
        return ["velocity" if linear else "angular velocity"]
    return ["length" if linear else "angle"]
