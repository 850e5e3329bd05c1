"""A log beside its model: clocks, joints that matched, and whether it can be diagnosed as it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.inspection.doubts import doubts
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.formats.plain import aliased_log
from mpge_jax.diagnosis.recordings.formats.registry import format_of, read_logs
from mpge_jax.diagnosis.recordings.formats.tables import Log, Table
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
        recording: what a diagnosis would get, or None; then `problem` says why not.
        doubts: what looks wrong. notes: what reading did to it.
    """

    log: Log
    format: str
    clocks: tuple[Clock, ...]
    joined: Joined | None
    recording: Recording | None
    problem: str | None
    doubts: tuple[str, ...]

    @property
    def notes(self) -> list[str]:
        said = self.recording.warnings if self.recording else tuple(self.joined.notes if self.joined else ())
        return [note.removeprefix(f"{self.log.name}: ") for note in said]


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
        seen = doubts(log, joined, recording, model, names)
        name = found.name if found else path.suffix.lower().removeprefix(".")
        out.append(
            Overview(log, name, tuple(map(Clock.of, log.tables)), joined, recording, problem, tuple(seen))
        )
    return out


def _plain(path: Path) -> list[Log]:
    log = aliased_log(path, every=True)
    if log is None:
        raise InputError(f"{path.name}: it holds no numbers.")
    return [log]
