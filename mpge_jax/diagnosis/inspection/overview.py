"""A log beside its model: clocks, joints that matched, and whether it can be diagnosed as it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.inspection.doubts import Doubt, doubts
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.formats.plain import aliased_log
from mpge_jax.diagnosis.recordings.formats.registry import format_of, read_logs
from mpge_jax.diagnosis.recordings.formats.tables import Column, Log, Table
from mpge_jax.diagnosis.recordings.joining import Joined, join
from mpge_jax.diagnosis.recordings.reader import mapped_keys, read_log, read_recording
from mpge_jax.diagnosis.recordings.recording import Recording

GAP = 5.0
"""Median steps from one row to the next beyond which rows are missing."""


@dataclass(frozen=True)
class Clock:
    """How the rows of a table follow one another; times in s, None where it has none.

    Attributes:
        gaps: steps of more than five usual ones. back: rows that are not later than the one before them.
    """

    table: str
    words: str
    rows: int
    step: float | None = None
    least: float = 0.0
    most: float = 0.0
    duration: float = 0.0
    gaps: int = 0
    back: int = 0

    @classmethod
    def of(cls, table: Table) -> Clock:
        if table.time is None or table.rows < 2:
            return cls(table.title, table.clock, table.rows)
        steps = np.diff(table.time)
        usual = float(np.median(steps))
        return cls(
            table.title,
            table.clock,
            table.rows,
            usual,
            float(steps.min()),
            float(steps.max()),
            float(table.time[-1] - table.time[0]),
            int((steps > GAP * usual).sum()) if usual > 0 else 0,
            int((steps <= 0).sum()),
        )


@dataclass(frozen=True)
class Overview:
    """One run of a log.

    Attributes:
        joined: how it is read as the model's motion, or None where no positions were recognised.
        given: what the map says, if there is one.
        recording: what a diagnosis would get, or None; then `problem` says why not.
        doubted: what looks wrong, and units that would put it right. notes: what reading did to it.
    """

    log: Log
    format: str
    clocks: tuple[Clock, ...]
    joined: Joined | None
    recording: Recording | None
    problem: str | None
    doubted: tuple[Doubt, ...]
    given: Mapping[str, object] = field(default_factory=dict)

    @property
    def doubts(self) -> list[str]:
        """What looks wrong, in sentences."""
        return [sentence for sentence, _ in self.doubted]

    @property
    def for_a_map(self) -> bool:
        """Whether a map could say more of the log: columns are not read, units look wrong, or it has no times."""
        read = {(id(c), i) for c, i in self.found.values()}
        parts = {(id(c), i) for t in self.log.tables for c in t.columns for i in range(c.values.shape[1])}
        timeless = "time" not in self.given and all(t.time is None for t in self.log.tables)
        return bool(parts - read) or timeless or any(units for _, units in self.doubted)

    @property
    def found(self) -> dict[str, tuple[Column, int]]:
        """What stands where, by the map or recognised: `qpos:elbow` to the column that it is read from, and which of
        its parts."""
        mapped = {target: place for target, entry in self.given.items() if (place := _named(self.log, entry))}
        return (self.joined.found if self.joined else {}) | mapped

    @property
    def notes(self) -> list[str]:
        said = self.recording.warnings if self.recording else tuple(self.joined.notes if self.joined else ())
        plain = [note.removeprefix(f"{self.log.name}: ") for note in said]
        return [note for note in plain if note.removesuffix(".") not in self.doubts]


def overviews(
    path: Path, model: mujoco.MjModel, names: Names, columns: Mapping[str, object] | None = None
) -> list[Overview]:
    """Look at every run of a file or a folder that is one log.

    Args:
        columns: what a map says, if there is one.

    Raises:
        InputError: it cannot be read at all.
    """
    columns, found = columns or {}, format_of(path)
    logs = read_logs(path) if found else _plain(path)
    out = []
    for log in logs:
        joined, recording, problem = None, None, None
        try:
            joined = join(log, model, names, mapped_keys(columns))
            if found:
                recording = read_log(log, path, model, names, columns)
        except InputError as error:
            problem = str(error)
        if not found:
            try:
                recording, problem = read_recording(path, model, names, columns), None
            except InputError as error:
                problem = str(error)
        seen, clocks = doubts(log, joined, recording, model, names), _clocks(log, recording, columns)
        name = found.name if found else path.suffix.lower().removeprefix(".")
        out.append(Overview(log, name, clocks, joined, recording, problem, tuple(seen), columns))
    return out


def _clocks(log: Log, recording: Recording | None, columns: Mapping[str, object]) -> tuple[Clock, ...]:
    """Those of the tables, or the one that a map made of the rows of a lone one."""
    if recording is not None and "time" in columns and len(log.tables) == 1:
        return (Clock.of(replace(log.tables[0], time=recording.time, clock="the map's times")),)
    return tuple(map(Clock.of, log.tables))


def _named(log: Log, entry: object) -> tuple[Column, int] | None:
    """The column of a log that an entry of a map names, and which of its parts."""
    entry = entry if isinstance(entry, Mapping) else {"from": entry}
    title, part = entry.get("from"), entry.get("column", 0)
    for column in (c for table in log.tables for c in table.columns):
        if column.titles is not None and title in column.titles:
            return column, column.titles.index(title)
        if column.title == title:
            part = column.parts.index(part) if column.parts and part in column.parts else part
            # what names no part of it is the reader's to tell
            return (column, part) if isinstance(part, int) else None
    return None


def _plain(path: Path) -> list[Log]:
    log = aliased_log(path, every=True)
    if log is None:
        raise InputError(f"{path.name}: it holds no numbers.")
    return [log]
