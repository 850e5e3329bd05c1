"""Read recordings from files of any format; no pickles are ever loaded."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.column_map import apply, apply_to, content, sources
from mpge_jax.diagnosis.recordings.command_lag import LONGEST, NOT_TOLD, common_lag, what_drives
from mpge_jax.diagnosis.recordings.formats.arrays import KEYS, raw_columns, read_npz
from mpge_jax.diagnosis.recordings.formats.plain import aliased_log, read_csv, unit_of
from mpge_jax.diagnosis.recordings.formats.registry import ARRAYS, find_files, other_logs, read_logs
from mpge_jax.diagnosis.recordings.formats.tables import Log, check_values
from mpge_jax.diagnosis.recordings.joining import Joined, columns_at, fill, join, listed
from mpge_jax.diagnosis.recordings.joint_names import joint_columns
from mpge_jax.diagnosis.recordings.recording import Recording, chain_transitions, from_zero
from mpge_jax.diagnosis.recordings.rows.full_turns import unwrapped
from mpge_jax.diagnosis.recordings.rows.rows_in_time import without_empty_rows
from mpge_jax.diagnosis.recordings.rows.stray_readings import without_stray_readings
from mpge_jax.diagnosis.recordings.validation import row_from_zero, validate


def _line(lines: list[int], row: int) -> str:
    """How a row of a CSV file is called: by its line in the file."""
    return f"line {lines[row]}"


def read_recording(
    path: Path, model: mujoco.MjModel, names: Names, columns: Mapping[str, object] | None = None
) -> Recording:
    """Read and check one .npz or .csv file. `columns` renames and converts (see `column_map`)."""
    columns = columns or {}
    called: Callable[[int], str] = row_from_zero
    if path.suffix.lower() == ".csv":
        data, lines = read_csv(path, model, names, sources(columns))
        called = partial(_line, lines)
    else:
        data = read_npz(path)
    notes: list[str] = []
    read = sources(columns)
    if _lacks(data, model):
        data, notes, titles = _by_aliases(path, data, columns, model, names)
        read |= titles
    if columns:
        data = apply(path, data, columns, model, names)
    for key in ("time", "qpos"):
        if key not in data:
            why = next((f"; {note.removesuffix('.')}" for note in notes if f" as {key}:" in note), "")
            shown = "qpos:JOINT" if key == "qpos" and path.suffix.lower() == ".csv" else key
            raise InputError(
                f"{path.name}: there is no '{shown}', but {', '.join(raw_columns(path, set())[1])[:300]}{why}; a "
                "recording needs 'time' and 'qpos' (a file with other names can be read with --map, and "
                "`python -m experiments.inspect` writes a map to start from)."
            )
    notes += _overlooked(path, data, read, model, names)
    return _recording(path.name, _readable(path.stem), data, model, names, called, notes)


def _lacks(data: Mapping[str, np.ndarray], model: mujoco.MjModel) -> bool:
    """Whether a file cannot be a recording by the names of its arrays alone."""
    if "time" not in data or "qpos" not in data:
        return True
    drives = any(k in data for k in ("ctrl", "actuator_force")) or model.nu == 0
    return not drives or (data["qpos"].dtype.kind == "f" and bool(np.isnan(data["qpos"]).all()))


def _by_aliases(
    path: Path,
    data: dict[str, np.ndarray],
    columns: Mapping[str, object],
    model: mujoco.MjModel,
    names: Names,
) -> tuple[dict[str, np.ndarray], list[str], set[str]]:
    """What a file lacks, from columns of other names that people use, unless a map names it; what there is to say of
    that, and the titles of these columns."""
    log = aliased_log(path)
    mapped = mapped_keys(columns)
    lacking = {"time", "qpos", "qvel", "ctrl", "actuator_force"} - set(mapped)
    lacking -= {k for k, v in data.items() if v.dtype.kind != "f" or not np.isnan(v).all()}
    if log is None or not lacking:
        return data, [], set()
    kept = {k: "" for k in ("qpos", "qvel", "ctrl", "actuator_force") if k not in lacking}
    joined = Joined(log.tables[0])
    fill(joined, log, kept, model, names)
    read = {title for column, _ in joined.found.values() for title in column.titles or (column.title,)}
    read |= {t.time_title for t in log.tables if t.time_title is not None}
    return {**data, **{k: v for k, v in joined.data.items() if k in lacking}}, joined.notes, read


def _overlooked(
    path: Path, data: Mapping[str, np.ndarray], read: set[str], model: mujoco.MjModel, names: Names
) -> list[str]:
    """What to say of columns of a CSV file that nothing is read from, where the positions of a joint are lacking.

    Args:
        read: titles of columns that are read, beside those that a recording has.
    """
    if path.suffix.lower() != ".csv":
        return []
    lacking = [name for name, i in joint_columns(model, names, "qpos") if np.isnan(data["qpos"][:, i]).all()]
    # the titles are another reading of the file
    titles = raw_columns(path, set())[1] if lacking else []
    unread = [t for t in titles if t not in read and unit_of(t)[0].partition(":")[0] not in KEYS]
    if not unread:
        return []
    return [
        f"{path.stem}: there are no positions of {', '.join(lacking)}, and {', '.join(unread)[:300]} "
        f"{'is' if len(unread) == 1 else 'are'} not read; if they are there under another name, call them "
        f"'qpos:{lacking[0]}' or give a map."
    ]


def mapped_keys(columns: Mapping[str, object]) -> dict[str, str]:
    """Keys that a map fills, each to one of the titles that it reads."""
    out: dict[str, str] = {}
    for target, entry in columns.items():
        title = entry.get("from", "") if isinstance(entry, dict) else entry
        out.setdefault(str(target).partition(":")[0], str(title))
    return out


def read_log(
    log: Log, path: Path, model: mujoco.MjModel, names: Names, columns: Mapping[str, object] | None = None
) -> Recording:
    """A run of a log in any other format as a recording of the model.

    Raises:
        InputError: it cannot be used; the message says what to do.
    """
    columns, within = columns or {}, 0.0
    data, notes, joined = _at_rows(log, path, model, names, columns, 0.0)
    if joined.apart and "ctrl" in data:
        ctrl = data["ctrl"]
        lag = common_lag(what_drives(data["time"], data["qpos"], data.get("qvel"), ctrl, model), ctrl)
        if lag is not None and lag.matters:
            data, notes, _ = _at_rows(log, path, model, names, columns, lag.common)
        said = NOT_TOLD if lag is None else lag.told(names.actuators)
        within = LONGEST if lag is None else lag.within
        notes = [
            *(f"{log.name}: {clock.told}." for clock in joined.apart.values()),
            f"{log.name}: {said}",
            *notes,
        ]
    recording = _recording(log.name, _readable(log.name), data, model, names, row_from_zero, notes)
    return replace(recording, origin=log.origin, clock_within=within)


def _at_rows(
    log: Log, path: Path, model: mujoco.MjModel, names: Names, columns: Mapping[str, object], lag: float
) -> tuple[dict[str, np.ndarray], list[str], Joined]:
    """A log's arrays by the keys of a recording, what there is to say of them, and how they were found.

    Args:
        lag: s after their stamps that commands on another clock than the states are taken to act.
    """
    joined = join(log, model, names, mapped_keys(columns), lag)
    data = joined.data
    if columns:
        data = apply_to(log.name, columns_at(joined, log), [listed(log)], data, columns, model, names)
    if "time" not in data:
        raise InputError(
            f"{log.name}: there are no times in {path.name}; say with --map how far its rows are apart, "
            "'columns: {time: {step: 0.02}}'."
        )
    if "qpos" not in data:
        raise InputError(
            f"{log.name}: no positions were found; {path.name} has {listed(log)} (--map says which)."
        )
    data, dropped = without_empty_rows(log.name, data)
    return data, [*(f"{log.name}: {note}" for note in joined.notes), *dropped], joined


def _readable(name: str) -> str:
    """Names of files need not be text, names in reports do."""
    return name.encode(errors="surrogateescape").decode(errors="replace")


def _recording(
    file: str,
    name: str,
    data: Mapping[str, np.ndarray],
    model: mujoco.MjModel,
    names: Names,
    called: Callable[[int], str],
    notes: Sequence[str],
) -> Recording:
    arrays: dict[str, np.ndarray] = {}
    for key, value in data.items():
        if value.dtype.kind not in "fiub":
            raise InputError(f"{file}: '{key}' does not hold numbers but {value.dtype}.")
        check_values(file, key, value.size)
        arrays[KEYS[key]] = np.asarray(value, dtype=float)
    for key in ("ctrl", "force") if model.nu == 0 else ():
        if np.nan_to_num(arrays.pop(key, np.zeros(0))).any():
            what = "commands ('ctrl')" if key == "ctrl" else "forces of actuators"
            raise InputError(
                f"{name} holds {what}, but the model has no actuators (a URDF never has): add them in an MJCF, as "
                '<actuator><motor joint="..."/></actuator> for commanded torques. Leave that column out only if '
                "nothing drove the machine: all that did would count as physics that is missing."
            )
    recording = Recording(
        name,
        arrays["time"],
        arrays["qpos"],
        arrays.get("qvel"),
        arrays.get("ctrl"),
        arrays.get("force"),
        tuple(notes),
    )
    return validate(recording, model, names, called)


def read_path(
    path: Path, model: mujoco.MjModel, names: Names, columns: Mapping[str, object] | None = None
) -> list[Recording]:
    """All runs in a file, or in a folder that is one log."""
    if path.suffix.lower() in ARRAYS and path.is_file():
        return [read_recording(path, model, names, columns)]
    return [read_log(log, path, model, names, columns) for log in read_logs(path)]


def counted(r: Recording) -> list[tuple[int, str]]:
    """Sorts recordings as people count: step_2 before step_10."""
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in re.split(r"(\d+)", r.name)]


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
    found = [r for p in files for r in read_path(p, model, names, columns)]
    folders = [
        p for p in map(Path, paths) if p.is_dir() and any(f.suffix.lower() in ARRAYS for f in p.iterdir())
    ]
    others = [f"{p}/{name}" for p in folders for name in other_logs(p)]
    if others:
        note = f"{', '.join(others)[:300]}: not read beside .npz and .csv files; name what should count by itself."
        found[0] = replace(found[0], warnings=(note, *found[0].warnings))
    if all(r.time.size == 2 for r in found):
        found = sorted(found, key=counted)
    return chain_transitions(found)


def read(
    recordings: Sequence[Recording] | Sequence[str | Path] | Recording | str | Path,
    model: mujoco.MjModel,
    names: Names,
    columns: Mapping[str, object] | str | Path | None = None,
) -> list[Recording]:
    """Recordings as the engine takes them: validated, transitions joined, angles continuous, time from zero.

    Args:
        recordings: files, folders, or `Recording`s in SI units. columns: renaming and conversion of files' columns, or
            the file of a map.

    Raises:
        InputError: the input cannot be used; the message says what to do.
    """
    given: Sequence[object] = [recordings]
    if isinstance(recordings, Sequence) and not isinstance(recordings, str):
        given = recordings
    for one in given:
        if not isinstance(one, str | Path | Recording):
            raise InputError(
                f"recordings are paths or Recording(name, time, qpos, qvel, ctrl), not {type(one).__name__}; "
                "of an .npz file, give the path."
            )
    ready = [r for r in given if isinstance(r, Recording)]
    files = [r for r in given if isinstance(r, str | Path)]
    checked = [validate(r, model, names) for r in ready]
    if files or not ready:
        checked += load_recordings(files, model, names, content(columns))
    # transitions follow one another as they were logged, so they are joined before angles are made continuous
    whole = [unwrapped(r, model, names) for r in chain_transitions(checked)]
    checked = [from_zero(without_stray_readings(r, model, names)) for r in whole]
    called = [r.name for r in checked]
    for name in called:
        if called.count(name) > 1:
            raise InputError(
                f"{called.count(name)} recordings are called '{name}'; give each a name of its own."
            )
    return checked
