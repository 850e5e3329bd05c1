"""Read recordings from `.npz` and `.csv` files; no pickles are ever loaded."""

from __future__ import annotations

import math
import re
import zipfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.column_map import apply, csv_places, raw_columns, sources
from mpge_jax.diagnosis.recordings.csv_table import MAX_VALUES, read_table
from mpge_jax.diagnosis.recordings.recording import (
    Recording,
    chain_transitions,
    from_zero,
    row_from_zero,
    unwrapped,
    validate,
)

OTHER_FORMATS = (
    ".mcap",
    ".bag",
    ".db3",
    ".h5",
    ".hdf5",
    ".parquet",
    ".mat",
    ".pkl",
    ".pickle",
    ".npy",
    ".tsv",
)
_KEYS = {"time": "time", "qpos": "qpos", "qvel": "qvel", "ctrl": "ctrl", "actuator_force": "force"}


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
            for key in _KEYS:
                if key in data.files:
                    _check_size(path, key, math.prod(_stated_shape(data, key)))
                    out[key] = data[key]
    except InputError:
        raise
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile, NotImplementedError) as error:
        reason = "it holds pickled objects" if "allow_pickle" in str(error) else "the file is damaged"
        raise InputError(f"cannot read {path.name}: {reason}; save plain arrays with numpy.savez.") from None
    except Exception as error:  # zlib and header parsers raise types of their own on damaged bytes
        raise InputError(f"cannot read {path.name}: {type(error).__name__} while reading it.") from None
    return out


def _stated_shape(data: np.lib.npyio.NpzFile, key: str) -> tuple[int, ...]:
    """The shape in the header of an array, which is not loaded."""
    if data.zip is None:
        raise EOFError
    with data.zip.open(f"{key}.npy") as member:
        first = np.lib.format.read_magic(member) == (1, 0)
        read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        return read(member)[0]


def _check_size(path: Path, key: str, size: int) -> None:
    if size > MAX_VALUES:
        raise InputError(f"{path.name}: '{key}' has {size} values; cut the recording into parts.")


def read_csv(
    path: Path, model: mujoco.MjModel, names: Names, renamed: Collection[str] = ()
) -> tuple[dict[str, np.ndarray], list[int]]:
    """Columns `time`, `qpos:JOINT`, `qvel:JOINT`, `ctrl:ACTUATOR`, `actuator_force:ACTUATOR` of a CSV file, and the
    line in which each row stands.

    A joint with several numbers has one column for each: `qpos:root:0` to `qpos:root:6`, `qvel:root:0` to
    `qvel:root:5`. Titles that are `renamed` by a map are left to it.
    """
    header, table, lines = read_table(path, lambda title: title.partition(":")[0] in _KEYS)
    out = {"qpos": np.full((len(table), model.nq), np.nan)}
    places = csv_places(model, names)
    for column, title in enumerate(header):
        if title == "time":
            out["time"] = table[:, column]
            continue
        key, _, rest = title.partition(":")
        if key not in _KEYS or title in renamed:
            continue
        if (key, rest) not in places:
            known = ", ".join(n for k, n in places if k == key)
            raise InputError(f"{path.name}: column '{title}' names nothing in the model (known: {known}).")
        width = {"qpos": model.nq, "qvel": model.nv}.get(key, model.nu)
        array = out.setdefault(key, np.full((len(table), width), np.nan))
        array[:, places[key, rest]] = table[:, column]
    return out, lines


def _line(lines: list[int], row: int) -> str:
    """How a row of a CSV file is called: by its line in the file."""
    return f"line {lines[row]}"


def read_recording(
    path: Path, model: mujoco.MjModel, names: Names, columns: Mapping[str, object] | None = None
) -> Recording:
    """Read and check one file. `columns` renames and converts (see `mapping.apply`)."""
    renamed = sources(columns or {})
    called: Callable[[int], str] = row_from_zero
    if path.suffix.lower() == ".csv":
        data, lines = read_csv(path, model, names, renamed)
        called = partial(_line, lines)
    else:
        data = read_npz(path)
    if columns:
        data = apply(path, data, columns, model, names)
    for key in ("time", "qpos"):
        if key not in data:
            raise InputError(
                f"{path.name}: there is no '{key}', but {', '.join(raw_columns(path, set())[1])[:300]}; a recording "
                "needs 'time' and 'qpos' (a file with other names can be read with --map)."
            )
    arrays: dict[str, np.ndarray] = {}
    for key, value in data.items():
        if value.dtype.kind not in "fiub":
            raise InputError(f"{path.name}: '{key}' does not hold numbers but {value.dtype}.")
        _check_size(path, key, value.size)
        value = np.asarray(value, dtype=float)
        if value.ndim == 1 and key != "time":
            value = value[:, None]
        arrays[_KEYS[key]] = value
    force = arrays.get("force")
    if force is not None and np.isnan(force).all():
        arrays.pop("force")
    if model.nu == 0:
        arrays.pop("ctrl", None)
        arrays.pop("force", None)
    recording = Recording(
        # names of files need not be text, names in reports do
        path.stem.encode(errors="surrogateescape").decode(errors="replace"),
        arrays["time"],
        arrays["qpos"],
        arrays.get("qvel"),
        arrays.get("ctrl"),
        arrays.get("force"),
    )
    return validate(recording, model, names, called)


def counted(r: Recording) -> list[tuple[int, str]]:
    """Sorts recordings as people count: step_2 before step_10."""
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in re.split(r"(\d+)", r.name)]


def find_files(paths: Iterable[str | Path]) -> list[Path]:
    """Recording files of the given files and folders, sorted by name; other files in a folder are left alone."""
    files: list[Path] = []
    for entry in map(Path, paths):
        if entry.is_dir():
            found = (p for p in entry.iterdir() if p.suffix.lower() in (".npz", ".csv") and p.is_file())
            inside = sorted(found)
            if not inside:
                other = ", ".join(other_logs(entry))
                raise InputError(
                    f"the folder {entry} holds no .npz or .csv file" + (f" (but {other})." if other else ".")
                )
            files += [p for p in inside if p.name != "next_experiment.npz"]
        elif entry.is_file():
            if entry.suffix.lower() not in (".npz", ".csv"):
                raise InputError(f"{entry.name} is neither .npz nor .csv.")
            files.append(entry)
        else:
            raise InputError(f"the recording {entry} does not exist.")
    # a link keeps its own name, which may say that it is held out
    unique: dict[Path, Path] = {}
    for path in files:
        unique.setdefault(path.resolve(), path)
    return list(unique.values())


def other_logs(folder: Path) -> list[str]:
    """Names of files in a folder that look like recordings in a format that is not read."""
    return sorted(p.name for p in folder.iterdir() if p.suffix.lower() in OTHER_FORMATS)


def load_recordings(
    paths: Iterable[str | Path],
    model: mujoco.MjModel,
    names: Names,
    columns: Mapping[str, object] | None = None,
) -> list[Recording]:
    """Read every recording; two-row transitions that follow each other are joined into episodes."""
    files = find_files(paths)
    if not files:
        raise InputError("no recording was given.")
    found = [read_recording(p, model, names, columns) for p in files]
    others = [f"{p}/{name}" for p in map(Path, paths) if p.is_dir() for name in other_logs(p)]
    if others:
        note = f"{', '.join(others)[:300]}: not read, as only .npz and .csv are; convert what should count."
        found[0] = replace(found[0], warnings=(note, *found[0].warnings))
    if all(r.time.size == 2 for r in found):
        found = sorted(found, key=counted)
    return chain_transitions(found)


def read(
    recordings: Sequence[Recording] | Sequence[str | Path] | str | Path,
    model: mujoco.MjModel,
    names: Names,
    columns: dict[str, object] | None = None,
) -> list[Recording]:
    """Recordings as the engine takes them: validated, transitions joined, angles continuous, time from zero.

    Args:
        recordings: files, folders, or `Recording`s in SI units. columns: renaming and conversion of files' columns.

    Raises:
        InputError: the input cannot be used; the message says what to do.
    """
    if isinstance(recordings, str | Path):
        recordings = [recordings]
    ready = [r for r in recordings if isinstance(r, Recording)]
    files = [r for r in recordings if not isinstance(r, Recording)]
    checked = [validate(r, model, names) for r in ready]
    if files or not ready:
        checked += load_recordings(files, model, names, columns)
    # transitions follow one another as they were logged, so they are joined before angles are made continuous
    checked = [from_zero(unwrapped(r, model, names)) for r in chain_transitions(checked)]
    called = [r.name for r in checked]
    for name in called:
        if called.count(name) > 1:
            raise InputError(
                f"{called.count(name)} recordings are called '{name}'; give each a name of its own."
            )
    return checked
