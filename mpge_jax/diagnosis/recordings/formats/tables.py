"""What a log holds, before it is read as the motion of a model: tables of columns, each table on one clock."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.formats.csv_table import MAX_VALUES

Array = np.ndarray
MAX_BYTES = 1 << 30
"""Most bytes of one piece of a log that is unpacked as a whole (a chunk, a message, a stored column)."""


@dataclass(frozen=True)
class Column:
    """One quantity of several parts, row by row.

    Attributes:
        title: what the log calls it, and what a map calls it.
        values: [T, n].
        parts: names of the n parts (joints, mostly) where the log has any.
        means: the key of a recording (`qpos`, `qvel`, `ctrl`, `actuator_force`) or `state` (MuJoCo's time, qpos, qvel
            and act in one row), where the format says so.
        quantity: what a command sets, `position`, `velocity` or `effort`, where the log tells.
        titles: of the n parts, where each is a column of its own in the file.
    """

    title: str
    values: Array
    parts: tuple[str, ...] | None = None
    means: str | None = None
    quantity: str | None = None
    titles: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Table:
    """Columns on one clock.

    Attributes:
        title: of the topic or group.
        time: [T] s from the log's `origin` on, or None where the log has no times.
        clock: whose times these are, in words.
        received: [T] s, when the recorder got the rows, where `time` is what the sender stamped.
        time_title: what a map calls the times, where they are a column of the file.
    """

    title: str
    columns: tuple[Column, ...]
    time: Array | None
    clock: str
    received: Array | None = None
    time_title: str | None = None

    @property
    def rows(self) -> int:
        return len(self.columns[0].values) if self.columns else 0


@dataclass(frozen=True)
class Log:
    """One run. `notes` say what was done to it, `unread` what else it holds; origin: s to add to all times."""

    name: str
    tables: tuple[Table, ...]
    notes: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    origin: float = 0.0


def extra(module: str, name: str) -> Any:
    """A package that only one format needs.

    Raises:
        InputError: it is not installed; the message says how to.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.partition(".")[0].replace("mcap_ros2", "mcap-ros2-support")
        raise InputError(
            f"such a log needs the package {package}: pip install {package} (the extra '{name}' of mpge-jax holds it)."
        ) from None


def check_values(file: str, what: str, count: int) -> None:
    """Refuse what would fill the memory, by the size that the file states."""
    if count > MAX_VALUES:
        raise InputError(f"{file}: '{what}' has {count} values; cut the recording into parts.")


def check_bytes(file: str, what: str, count: int) -> None:
    """Refuse a piece that is larger unpacked than any sensible log's."""
    if count > MAX_BYTES:
        raise InputError(
            f"{file}: {what} would take {count / 2**30:.3g} GB unpacked, more than any log's should; it is not "
            "read."
        )
