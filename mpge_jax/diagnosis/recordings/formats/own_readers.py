"""Readers of a user's own: a Python file registers what reads its logs, which are then recordings like all others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mpge_jax import own_code
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.formats.registry import ARRAYS, OWN, Format, formats
from mpge_jax.diagnosis.recordings.formats.tables import Column, Log, Table

Read = Callable[[Path], list[Log]]
_read: dict[Path, tuple[str, ...]] = {}
"""File that was loaded -> what it registered."""


def register_reader(
    name: str, *endings: str, is_folder: Callable[[Path], bool] = lambda _path: False
) -> Callable[[Read], Read]:
    """Decorate `read(path) -> [Log, ...]`: the runs in a file or folder, as tables of columns, each on one clock.

    Columns are joined to the model's joints and actuators by their names afterwards, as those of any log are.

    Args:
        name: of the format. endings: of its files, as `.log7`. is_folder: whether a folder is one log of it.

    Raises:
        InputError: an ending or the name is another format's, or is none.
    """
    known = formats()
    for ending in endings:
        if not (
            isinstance(ending, str)
            and ending.startswith(".")
            and ending == ending.lower()
            and len(ending) > 1
        ):
            raise InputError(
                f"reader '{name}': an ending is like '.log7' (with a point, in small letters), not {ending!r}."
            )
        taken = next(
            (f.name for f in known if ending in f.endings), ".npz and .csv" if ending in ARRAYS else None
        )
        if taken is not None:
            raise InputError(f"reader '{name}': files that end in {ending} are read already ({taken}).")
    if name in [f.name for f in known]:
        raise InputError(f"a reader named '{name}' exists already.")

    def add(read: Read) -> Read:
        OWN.append(Format(name, endings, is_folder, lambda path: _checked(name, read(path)), own=True))
        return read

    return add


def load_readers(path: Path | str) -> tuple[str, ...]:
    """Run a file that decorates functions with `register_reader`: what they read is then read everywhere.

    Returns the names of its formats; a file that was loaded before is not run again.

    Raises:
        InputError: there is no such file, it cannot be run, registers nothing, or an ending that is taken.
    """
    path = Path(path)
    where, before = path.resolve(), list(OWN)
    if where in _read:
        return _read[where]
    try:
        own_code.load(path)
    except ValueError as error:
        OWN[:] = before
        raise InputError(f"{error}".removesuffix(".") + ".") from None
    added = OWN[len(before) :]
    if not added:
        raise InputError(
            f"{path} registers no reader; put @register_reader('NAME', '.ending') (from mpge_jax.diagnosis) above a "
            "function that reads a path."
        )
    _read[where] = tuple(f.name for f in added)
    return _read[where]


def _checked(name: str, logs: Any) -> list[Log]:
    """What a reader gave, as tables of numbers.

    Raises:
        InputError: it is something else; says what and where.
    """
    said = f"the reader '{name}'"
    if not isinstance(logs, list | tuple) or not logs or not all(isinstance(x, Log) for x in logs):
        raise InputError(f"{said} must return a list of Log, at least one; it returned {_kind(logs)}.")
    return [replace(log, tables=tuple(_table(said, log, t) for t in log.tables)) for log in logs]


def _table(said: str, log: Log, table: Any) -> Table:
    if not isinstance(table, Table):
        raise InputError(f"{said}: the tables of {log.name} must be Table, not {_kind(table)}.")
    columns = tuple(_column(f"{said}: {log.name}", c) for c in table.columns)
    lengths = {len(c.values) for c in columns} | ({len(table.time)} if table.time is not None else set())
    if len(lengths) > 1:
        raise InputError(
            f"{said}: the columns of {log.name} have {sorted(lengths)} rows; those of a table need one number."
        )
    return replace(
        table, columns=columns, time=None if table.time is None else _numbers(said, "time", table.time, (1,))
    )


def _column(said: str, column: Any) -> Column:
    if not isinstance(column, Column):
        raise InputError(f"{said}: a table's columns must be Column, not {_kind(column)}.")
    values = _numbers(said, column.title, column.values, (1, 2))
    values = values[:, None] if values.ndim == 1 else values
    if column.parts is not None and len(column.parts) != values.shape[1]:
        raise InputError(
            f"{said}: '{column.title}' has {values.shape[1]} columns and {len(column.parts)} names of parts."
        )
    return replace(column, values=values)


def _numbers(said: str, title: str, values: Any, dimensions: tuple[int, ...]) -> np.ndarray:
    try:
        out = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{said}: '{title}' does not hold numbers but {_kind(values)}.") from None
    if out.ndim not in dimensions:
        shape = "[T]" if dimensions == (1,) else "[T] or [T, n]"
        raise InputError(f"{said}: '{title}' must have the shape {shape}, not {out.shape}.")
    return out


def _kind(value: Any) -> str:
    return (
        "nothing"
        if value is None
        else f"an empty {type(value).__name__}"
        if value in ([], ())
        else type(value).__name__
    )
