"""Read a table of numbers from a CSV file, row by row, so that its text is never in memory as a whole."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from mpge_jax.diagnosis.errors import InputError

MAX_VALUES = 400_000_000
"""Most numbers read from one file (about 3 GB); longer logs must be cut."""


def read_table(path: Path, must: Callable[[str], bool]) -> tuple[list[str], np.ndarray, list[int]]:
    """Titles of the columns, the cells [T, columns], and the line of the file in which each row stands [T].

    Args:
        must: whether a column of that title has to hold numbers. Empty cells are NaN, and so is what is no number in
            the other columns.

    Raises:
        InputError: the file cannot be read, is no table, or a cell is no number.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = _header(path, reader)
            twice = next((h for h in header if must(h) and header.count(h) > 1), None)
            if twice is not None:
                raise InputError(f"{path.name}: the column '{twice}' appears twice in the header.")
            rows = ((reader.line_num, row) for row in reader if row)
            cells, lines = _cells(path, header, [must(h) for h in header], rows)
    except UnicodeDecodeError:
        raise InputError(f"cannot read {path.name}: it is not UTF-8 text; save it as CSV in UTF-8.") from None
    except (OSError, csv.Error) as error:
        raise InputError(f"cannot read {path.name}: {error}.") from None
    if not cells:
        raise InputError(f"{path.name}: there are no rows below the header; the first line is the header.")
    return header, np.frombuffer(cells, dtype=float).reshape(-1, len(header)), lines


def _header(path: Path, reader: Iterator[list[str]]) -> list[str]:
    """Titles of the columns: the first line that is no comment, or that a comment holds, as `numpy.savetxt` writes
    them."""
    header = [title.strip() for title in next(reader, [])]
    while len(header) == 1 and header[0].startswith("#"):
        header = [title.strip() for title in next(reader, [])]
    if not header:
        return header
    header[0] = header[0].removeprefix("#").strip()
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise InputError(f"{path.name}: columns are separated by {word}; save it with commas.")
    if all(map(_is_number, header)):
        raise InputError(
            f"{path.name}: the first line holds numbers; it has to name the columns (time, qpos:JOINT, ctrl:ACTUATOR)."
        )
    return header


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _cells(
    path: Path, header: list[str], must: list[bool], rows: Iterable[tuple[int, list[str]]]
) -> tuple[array[float], list[int]]:
    """All cells, row by row, and the rows' lines. rows: (line in the file, its cells)."""
    out, lines = array("d"), []
    for line, row in rows:
        lines.append(line)
        if len(row) != len(header):
            raise InputError(
                f"{path.name}: line {line} has {len(row)} cells, but the header has {len(header)} columns."
            )
        for title, needed, text in zip(header, must, row, strict=True):
            cell = text.strip()
            try:
                out.append(float(cell) if cell else np.nan)
            except ValueError:
                if needed:
                    raise InputError(
                        f"{path.name}: '{cell[:40]}' in column '{title}', line {line}, is no number."
                    ) from None
                out.append(np.nan)
        if len(out) > MAX_VALUES:
            raise InputError(f"{path.name} has more than {MAX_VALUES} values; cut the recording into parts.")
    return out, lines
