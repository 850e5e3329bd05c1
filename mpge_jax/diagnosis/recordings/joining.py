"""From the tables of a log to the arrays of a recording: joints and actuators by name, everything on one clock."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.column_map import Lookup, csv_places
from mpge_jax.diagnosis.recordings.formats import aliases
from mpge_jax.diagnosis.recordings.formats.tables import Column, Log, Table
from mpge_jax.diagnosis.recordings.joint_names import (
    driven_joints,
    joint_columns,
    match,
    match_actuators,
    numbered,
)
from mpge_jax.diagnosis.recordings.rows.rows_in_time import Clock, held, interpolated, middles

Array = np.ndarray
LISTED = 300
"""Most letters of a list in a message."""


@dataclass
class Joined:
    """A log read as the motion of a model.

    Attributes:
        base: the table whose rows are the recording's.
        data: arrays by the keys of a recording; a number that was not found is NaN.
        found: what stands where: `qpos:elbow` to the column that it is read from, and which of its parts.
        notes: what a user should know of how it was read.
        lag: s after their stamps that commands on a clock of their own are taken to act.
        apart: those clocks, by the table's title.
    """

    base: Table
    lag: float = 0.0
    data: dict[str, Array] = field(default_factory=dict)
    found: dict[str, tuple[Column, int]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    apart: dict[str, Clock] = field(default_factory=dict)

    def at_rows(self, table: Table, value: Array, key: str) -> Array | None:
        """A column [S] of any table at the rows of `base` [T]: commands held until the next, others interpolated. None
        where one of the two has no times."""
        if table is self.base:
            return value
        if table.time is None or self.base.time is None:
            return None
        clock = Clock.of(self.base, table)
        time = table.time - clock.ahead
        if key != "ctrl":
            return interpolated(self.base.time, time, value)
        self.apart[table.title] = clock
        return held(middles(self.base.time), time + self.lag, value)


def join(
    log: Log, model: mujoco.MjModel, names: Names, mapped: Mapping[str, str] | None = None, lag: float = 0.0
) -> Joined:
    """Read a log without being told what its columns are, except for those that a map names.

    Args:
        mapped: keys of a recording that a map fills (`qpos`, ...) to one of the titles that it reads them from. These
            keys are left to the map, and positions decide whose rows the recording has.
        lag: see `Joined`.

    Raises:
        InputError: nothing in the log is recognised as positions.
    """
    mapped = mapped or {}
    out = Joined(_base(log, model, names, mapped), lag)
    out.notes += log.notes
    fill(out, log, mapped, model, names)
    return out


def fill(out: Joined, log: Log, mapped: Collection[str], model: mujoco.MjModel, names: Names) -> None:
    """All keys of a recording that no map names and the log has, at the rows of `out.base`."""
    if out.base.time is not None and "time" not in mapped:
        out.data["time"] = out.base.time
    for key in ("qpos", "qvel", "actuator_force"):
        if key not in mapped:
            _measured(out, log, key, model, names)
    if "ctrl" not in mapped:
        _commands(out, log, model, names)
    for column in out.base.columns:
        if column.means == "state" and not {"qpos", "qvel"} & {*mapped, *out.data}:
            _state(out, column, model, names)


def _base(log: Log, model: mujoco.MjModel, names: Names, mapped: Mapping[str, str]) -> Table:
    """The table with the positions of most joints; of several the one with most rows."""
    if not log.tables:
        raise InputError(f"{log.name}: it holds no numbers that can be read{_beside(log)}.")
    title = mapped.get("qpos") or mapped.get("time")
    if title:
        holds = [t for t in log.tables if any(c.title == title for c in t.columns)]
        if not holds:
            raise InputError(f"{log.name}: the map's '{title}' is not in the log (it has {listed(log)}).")
        return holds[0]

    def rank(table: Table) -> tuple[int, int]:
        columns = [c for c in table.columns if c.means == "qpos"]
        counts = [len(_places(c, "qpos", model, names)) for c in columns]
        counts += [model.nq for c in table.columns if c.means == "state"]
        return max(counts, default=0), table.rows

    best = max(log.tables, key=rank)
    if rank(best)[0] == 0:
        raise InputError(
            f"{log.name}: nothing in it is recognised as positions of {_few(names.joints)}; it has {listed(log)}"
            f"{_beside(log)}; say with --map what is what."
        )
    return best


def listed(log: Log) -> str:
    """Titles of a log, and the parts that they have."""
    titles = [
        c.title + (f" [{_few(c.parts)}]" if c.parts else f" [{c.values.shape[1]}]")
        for t in log.tables
        for c in t.columns
    ]
    return _few(titles)


def _beside(log: Log) -> str:
    return f" (not read: {_few(log.unread)})" if log.unread else ""


def _few(texts: Iterable[str]) -> str:
    text = ", ".join(texts)
    return text if len(text) <= LISTED else text[:LISTED] + " ..."


def _places(column: Column, key: str, model: mujoco.MjModel, names: Names) -> dict[int, int]:
    """Column of `values` to column of the recording's array, for those that are known."""
    n, width = column.values.shape[1], {"qpos": model.nq, "qvel": model.nv}.get(key, model.nu)
    in_order = {i: i for i in range(n)} if n == width else {}
    if column.parts is None:
        return in_order
    # `root:2`, as titles of a recording have it
    places = csv_places(model, names)
    if all((key, part) in places for part in column.parts):
        return {i: places[key, part] for i, part in enumerate(column.parts)}
    if key in ("qpos", "qvel"):
        targets = joint_columns(model, names, key)
        found = {i: targets[j][1] for i, j in match(column.parts, [t for t, _ in targets]).items()}
    elif key == "actuator_force":
        found = match(column.parts, driven_joints(model, names))
    else:
        found = match_actuators(column.parts, model, names)
    # motor_0, motor_1, ... say no more than their order does
    return found if found or not numbered(column.parts) else in_order


def _where(key: str, column: int, model: mujoco.MjModel, names: Names) -> str:
    """`qpos:elbow` and its like, as CSV titles and maps have them."""
    return next(f"{k}:{name}" for (k, name), i in csv_places(model, names).items() if (k, i) == (key, column))


def _measured(out: Joined, log: Log, key: str, model: mujoco.MjModel, names: Names) -> None:
    """Positions, velocities or forces: from the table whose rows count, else from others by interpolation."""
    width = {"qpos": model.nq, "qvel": model.nv}.get(key, model.nu)
    if not width:
        return
    array = np.full((out.base.rows, width), np.nan)
    others = sorted((t for t in log.tables if t is not out.base), key=lambda t: -t.rows)
    for table in (out.base, *others):
        for column in (c for c in table.columns if c.means == key):
            new = {i: j for i, j in _places(column, key, model, names).items() if np.isnan(array[:, j]).all()}
            if not new:
                continue
            for i, j in sorted(new.items(), key=lambda pair: pair[1]):
                value = out.at_rows(table, column.values[:, i], key)
                if value is None:
                    continue
                array[:, j] = value * _per_force(column, key, j, model)
                out.found[_where(key, j, model, names)] = (column, i)
            if table is not out.base and out.base.time is not None and table.time is not None:
                out.notes.append(f"{column.title} is interpolated at the times of {out.base.title}.")
    if any(k.startswith(f"{key}:") for k in out.found):
        out.data[key] = array
        return
    for column in (c for t in log.tables for c in t.columns if c.means == key):
        why = f"it has {column.values.shape[1]} numbers a row and the model {width}"
        if column.parts is not None:
            why = f"{_few(column.parts)} name none of {_few(_targets(key, names))}"
        out.notes.append(f"{column.title} is not read as {key}: {why}; --map can say which is which.")


def _targets(key: str, names: Names) -> tuple[str, ...]:
    return names.joints if key in ("qpos", "qvel") else names.actuators


def _per_force(column: Column, key: str, actuator: int, model: mujoco.MjModel) -> float:
    """A joint's effort is a torque at the joint; the actuator's force is that by its gear."""
    at_joint = key == "actuator_force" and not aliases.is_of_actuators(column.title)
    gear = float(model.actuator_gear[actuator, 0]) if at_joint else 1.0
    return 1.0 / gear if gear else 1.0


def quantity_of(model: mujoco.MjModel, a: int) -> str | None:
    """What an actuator is told: a position, a velocity or an effort; None where that is not clear."""
    affine = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE
    if model.actuator_gaintype[a] != mujoco.mjtGain.mjGAIN_FIXED:
        return None
    if not affine:
        return "effort" if model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE else None
    if model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        return "velocity"
    return (
        "position" if model.actuator_biasprm[a, 1] else ("velocity" if model.actuator_biasprm[a, 2] else None)
    )


def _commands(out: Joined, log: Log, model: mujoco.MjModel, names: Names) -> None:
    """Commands of every actuator from the first column that has them in the quantity that it is told, held until the
    next."""
    array = np.full((out.base.rows, model.nu), np.nan)
    unfit: dict[str, list[str]] = {}
    also: dict[str, list[str]] = {}
    # sent on a topic of their own before what a controller says that it was told
    tables = sorted(log.tables, key=lambda t: (t is not out.base, t.title.endswith("state")))
    for table in tables:
        for column in (c for c in table.columns if c.means == "ctrl"):
            for i, a in _places(column, "ctrl", model, names).items():
                wanted = quantity_of(model, a)
                if None not in (column.quantity, wanted) and column.quantity != wanted:
                    text = f"{column.title} holds commands of {column.quantity}, but the model's actuators are told"
                    unfit.setdefault(f"{text} {'an' if wanted == 'effort' else 'a'} {wanted}", []).append(
                        names.actuators[a]
                    )
                    continue
                if not np.isnan(array[:, a]).all():
                    also.setdefault(column.title, []).append(names.actuators[a])
                    continue
                value = out.at_rows(table, column.values[:, i], "ctrl")
                if value is None:
                    continue
                array[:, a] = value
                out.found[f"ctrl:{names.actuators[a]}"] = (column, i)
    lacking = [names.actuators[a] for a in range(model.nu) if np.isnan(array[:, a]).all()]
    out.notes += [
        f"{text} ({_few(of)}): they are not read." for text, of in unfit.items() if set(of) & set(lacking)
    ]
    out.notes += [
        f"{title} holds commands of {_few(of)} too, which are not read." for title, of in also.items()
    ]
    if len(lacking) == model.nu:
        return
    if not lacking:
        out.data["ctrl"] = array
    else:
        out.apart.clear()
        out.found = {target: source for target, source in out.found.items() if not target.startswith("ctrl:")}
        out.notes.append(f"commands of {_few(lacking)} were not found, so no commands are read.")


def _state(out: Joined, column: Column, model: mujoco.MjModel, names: Names) -> None:
    """MuJoCo's state in one row: time, qpos, qvel and what the actuators hold."""
    values, nq, nv = column.values, model.nq, model.nv
    if values.shape[1] not in (1 + nq + nv, 1 + nq + nv + model.na):
        out.notes.append(
            f"'{column.title}' has {values.shape[1]} numbers a row, not the {1 + nq + nv} of this model's time, qpos "
            "and qvel; it is not read."
        )
        return
    out.data["qpos"], out.data["qvel"] = values[:, 1 : 1 + nq], values[:, 1 + nq : 1 + nq + nv]
    for key, first, width in (("qpos", 1, nq), ("qvel", 1 + nq, nv)):
        out.found |= {_where(key, j, model, names): (column, first + j) for j in range(width)}
    if (np.diff(values[:, 0]) > 0).all():
        out.data["time"] = values[:, 0]


def columns_at(joined: Joined, log: Log) -> Lookup:
    """What a map asks for: a title and the key that it is for, to values [T] or [T, n] at the recording's rows and the
    names of its parts. Commands are held until the next, other numbers interpolated."""

    def look(title: str, key: str) -> tuple[Array, tuple[str, ...] | None] | None:
        for table in log.tables:
            for column in (c for c in table.columns if c.title == title):
                if table is not joined.base and key == "time":
                    return None
                at_rows = [joined.at_rows(table, v, key) for v in column.values.T]
                if any(v is None for v in at_rows):
                    return None
                values = np.stack([v for v in at_rows if v is not None], axis=1)
                return (values if values.shape[1] > 1 else values[:, 0]), column.parts
        return None

    return look
