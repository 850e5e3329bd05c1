"""HDF5 files: D4RL, Minari, robomimic, ALOHA, or datasets by the names of a recording's keys."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.formats import aliases
from mpge_jax.diagnosis.recordings.formats.tables import Column, Log, Table, check_bytes, check_values, extra

MAX_DATASETS = 100_000
DEPTH = 8
EPISODE = re.compile(r"(episode|demo|traj|trajectory|run)[_-]?(\d+)$")
"""Names of groups that hold a run each."""
ENDS = ("terminals", "timeouts", "terminations", "truncations", "dones")
"""Flags of the last row of an episode, in files that hold one after another."""
MADE_UP = "the rate that the file states"


def read(path: Path) -> list[Log]:
    """Every episode of a file, or of a Minari dataset's folder, is a run."""
    path = main_file(path) if path.is_dir() else path
    name = path.parent.parent.name if path.name == "main_data.hdf5" else path.stem
    with extra("h5py", "h5").File(path, "r") as file:
        runs = _runs(path, file)
        if not runs:
            return _by_flags(_log(path, file, name, {}))
        about = _arguments(file)
        return [_log(path, group, f"{name}_{key}", about) for key, group in runs]


def main_file(folder: Path) -> Path:
    """Where Minari keeps the data of a dataset."""
    inside = folder / "data" / "main_data.hdf5"
    return inside if inside.is_file() else folder / "main_data.hdf5"


def _runs(path: Path, file: Any) -> list[tuple[str, Any]]:
    """Groups of one run each, in counting order, from the root or from `data`."""
    home = _own(path, file, "data") if "data" in file else file
    home = home if hasattr(home, "keys") else file
    names = sorted((int(m[2]), key) for key in home if (m := EPISODE.match(key)))
    return [(key, group) for _, key in names if hasattr(group := _own(path, home, key), "keys")]


def _own(path: Path, group: Any, key: str) -> Any:
    """A member that lies in this very file: links into other files are not followed."""
    if isinstance(group.get(key, getlink=True), extra("h5py", "h5").ExternalLink):
        raise InputError(
            f"{path.name}: '{key}' is a link into another file, which is not followed; copy the data in."
        )
    return group.get(key)


def _datasets(path: Path, group: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    if depth > DEPTH:
        raise InputError(f"{path.name}: its groups lie more than {DEPTH} deep.")
    for key in group:
        member = _own(path, group, key)
        if hasattr(member, "keys"):
            yield from _datasets(path, member, f"{prefix}{key}/", depth + 1)
        elif hasattr(member, "shape"):
            yield f"{prefix}{key}", member


def _log(path: Path, group: Any, name: str, about: dict[str, Any]) -> Log:
    arrays: dict[str, np.ndarray] = {}
    unread: list[str] = []
    total = 0
    for count, (title, data) in enumerate(_datasets(path, group)):
        if count > MAX_DATASETS:
            raise InputError(f"{path.name} holds more than {MAX_DATASETS} datasets in one group.")
        if (
            data.shape is None
            or len(data.shape) not in (1, 2)
            or data.dtype.kind not in "fiub"
            or not data.shape[0]
        ):
            unread.append(f"{title} {data.dtype}{list(data.shape or ())}")
            continue
        total += int(np.prod(data.shape))
        arrays[title] = _plain(path, title, data, total)
    unread += [t for t, a in arrays.items() if len(a) != _rows(arrays)]
    return _of_arrays(name, arrays, unread, about)


def _plain(path: Path, title: str, data: Any, total: int) -> np.ndarray:
    """The numbers of a dataset that lies in this file."""
    if data.external or data.is_virtual:
        raise InputError(
            f"{path.name}: '{title}' lies in other files, which are not opened; copy the data in."
        )
    check_values(path.name, title, total)
    if data.chunks:
        check_bytes(path.name, f"a chunk of '{title}'", int(np.prod(data.chunks)) * data.dtype.itemsize)
    return np.asarray(data[()], dtype=float)


def _rows(arrays: dict[str, np.ndarray]) -> int:
    """Rows of the positions, or else of most arrays."""
    found = aliases.best(arrays)
    if "qpos" in found:
        return len(arrays[found["qpos"]])
    sizes = [len(a) for a in arrays.values()]
    return max(set(sizes), key=sizes.count, default=0)


def _of_arrays(name: str, arrays: dict[str, np.ndarray], unread: list[str], about: dict[str, Any]) -> Log:
    """One table of the arrays that have a row for each position.

    Commands have one row less where the last observation has none: that row's command belongs to no step.
    """
    rows, notes = _rows(arrays), []
    for title in [t for t, a in arrays.items() if len(a) == rows - 1]:
        arrays[title] = np.concatenate([arrays[title], arrays[title][-1:]])
        unread.remove(title)
    arrays = {t: a for t, a in arrays.items() if len(a) == rows}
    found = aliases.best(arrays)
    time, clock, step = None, "none", _step(about)
    if "time" in found and arrays[found["time"]].ndim == 1:
        time, clock = arrays[found["time"]], "its own times"
    elif step is not None:
        time, clock = np.arange(rows) * step, MADE_UP
        notes = [f"times are made up from the rate that the file states, {1 / step:.4g} rows a second."]
    means = {title: key for key, title in found.items() if key != "time"}
    controller = _controller(about)
    if controller is not None and not controller.upper().startswith("JOINT"):
        means = {title: key for title, key in means.items() if key != "ctrl"}
        notes.append(f"its actions are those of a {controller} controller, which are not commands of joints.")
    columns = tuple(
        Column(t, a if a.ndim == 2 else a[:, None], means="state" if t == "states" else means.get(t))
        for t, a in arrays.items()
    )
    tables = (Table("", columns, time, clock),) if columns else ()
    return Log(name, tables, tuple(notes), tuple(unread))


def _arguments(file: Any) -> dict[str, Any]:
    """robomimic's description of the environment, if there is any."""
    home = file["data"] if "data" in file and hasattr(file["data"], "attrs") else file
    try:
        found = json.loads(home.attrs.get("env_args", "{}"))["env_kwargs"]
        return dict(found)
    except (KeyError, TypeError, ValueError, RecursionError):
        return {}


def _step(about: dict[str, Any]) -> float | None:
    """Seconds between rows."""
    rate = about.get("control_freq")
    return 1.0 / rate if isinstance(rate, int | float) and rate > 0 else None


def _controller(about: dict[str, Any]) -> str | None:
    """What turns actions into commands of joints, as robosuite names it."""
    config = about.get("controller_configs")
    parts = config.get("body_parts") if isinstance(config, dict) else None
    if isinstance(parts, dict):
        config = next((p for p in parts.values() if isinstance(p, dict)), config)
    return str(config["type"]) if isinstance(config, dict) and "type" in config else None


def _by_flags(log: Log) -> list[Log]:
    """Episodes of a file in which they follow one another, as D4RL's do, with a flag in the last row of each."""
    if not log.tables:
        return [log]
    (table,) = log.tables
    flags = [c.values[:, 0] for c in table.columns if c.title in ENDS]
    if not flags:
        return [log]
    ends = np.flatnonzero(np.any(np.nan_to_num(flags) > 0, axis=0)) + 1
    edges = [0, *(int(e) for e in ends if e < table.rows), table.rows]
    out = []
    for i, (a, b) in enumerate(pairwise(edges)):
        columns = tuple(Column(c.title, c.values[a:b], c.parts, c.means, c.quantity) for c in table.columns)
        time = None if table.time is None else table.time[a:b]
        out.append(Log(f"{log.name}_{i}", (Table("", columns, time, table.clock),), log.notes, log.unread))
    return [r for r in out if r.tables[0].rows > 1]
