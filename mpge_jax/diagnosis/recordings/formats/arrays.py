"""Arrays of `.npz` and columns of `.csv` files by the names that they have; no pickles are loaded."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path

import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.formats.csv_table import read_table
from mpge_jax.diagnosis.recordings.formats.tables import check_values

KEYS = {"time": "time", "qpos": "qpos", "qvel": "qvel", "ctrl": "ctrl", "actuator_force": "force"}
"""Keys of a recording, and what `Recording` calls them."""


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a recording by their contract key.

    Raises:
        InputError: the file is damaged, holds pickled objects, or lacks `time` or `qpos`.
    """
    out: dict[str, np.ndarray] = {}
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            if not isinstance(data, np.lib.npyio.NpzFile):
                raise InputError(f"{path.name} is a single array, not an .npz archive.")
            for key in KEYS:
                if key in data.files:
                    check_values(path.name, key, math.prod(_stated(data, key)[0]))
                    out[key] = data[key]
    except InputError:
        raise
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile, NotImplementedError) as error:
        reason = _reason(path, error)
        raise InputError(f"cannot read {path.name}: {reason}; save plain arrays with numpy.savez.") from None
    except Exception as error:  # zlib and header parsers raise types of their own on damaged bytes
        raise InputError(f"cannot read {path.name}: {type(error).__name__} while reading it.") from None
    return out


def _reason(path: Path, error: Exception) -> str:
    """Why NumPy cannot read a file: it takes what is neither an archive nor an array for a pickle."""
    if "allow_pickle" not in str(error):
        return "the file is damaged"
    archive = path.read_bytes()[:1] in (b"P", b"\x93", b"\x80")
    return "it holds pickled objects" if archive else "it is no .npz file"


def _stated(data: np.lib.npyio.NpzFile, key: str) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type in the header of an array, which is not loaded."""
    if data.zip is None:
        raise EOFError
    with data.zip.open(f"{key}.npy") as member:
        first = np.lib.format.read_magic(member) == (1, 0)
        read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        shape, _, kind = read(member)
        return shape, kind


def raw_columns(
    path: Path, wanted: set[str], numbers_only: bool = False
) -> tuple[dict[str, np.ndarray], list[str]]:
    """The columns `wanted` of a file, before any meaning is given to them, and the titles of all.

    Args:
        numbers_only: leave out what only a pickle holds, instead of refusing it.
    """
    if path.suffix.lower() == ".csv":
        titles, table, _ = read_table(path, lambda _title: False)
        return {t: table[:, i] for i, t in enumerate(titles) if t in wanted}, list(titles)
    try:
        with path.open("rb") as binary, np.load(binary, allow_pickle=False) as data:
            wanted = {k for k in wanted if not numbers_only or _stated(data, k)[1].kind in "fiub"}
            return {k: _plain(path, data, k) for k in data.files if k in wanted}, list(data.files)
    except InputError:
        raise
    except Exception as error:  # damaged archives raise types of their own
        raise InputError(f"cannot read {path.name}: {_reason(path, error)}.") from None


def _plain(path: Path, data: np.lib.npyio.NpzFile, key: str) -> np.ndarray:
    try:
        check_values(path.name, key, math.prod(_stated(data, key)[0]))
        return data[key]
    except InputError:
        raise
    except ValueError:  # objects, which only a pickle holds
        raise InputError(f"{path.name}: the map's '{key}' does not hold plain numbers.") from None
