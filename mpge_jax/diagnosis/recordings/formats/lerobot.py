"""LeRobot datasets (versions 2 and 3): a folder with `meta/info.json` and Parquet files of rows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.formats import aliases
from mpge_jax.diagnosis.recordings.formats.tables import Column, Log, Table, check_bytes, check_values, extra

MAX_INFO = 10 << 20
BATCH = 1 << 14
"""Rows that are taken out of a file at a time."""
SYNTHETIC = "frame_index / fps"
SAID = (
    "times are frame_index / fps, made up by the recorder and not measured: how late commands or readings were is not "
    "in this log, and a delay that is found in it may be the recorder's."
)


def is_dataset(folder: Path) -> bool:
    return (folder / "meta" / "info.json").is_file()


def read(path: Path) -> list[Log]:
    """Every episode of the folder is a run."""
    info = _info(path / "meta" / "info.json")
    features = {t: f for t, f in info["features"].items() if isinstance(f, dict)}
    # the files that are there, and not those that info.json would lead to
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise InputError(f"the folder {path} holds no data/**/*.parquet; download the dataset as a whole.")
    arrays, unread = _read_files(files, features)
    if "episode_index" not in arrays:
        raise InputError(f"{path.name}: its Parquet files have no column 'episode_index'.")
    episode = arrays["episode_index"][:, 0]
    columns = [
        Column(title, values, _parts(features.get(title, {}), values.shape[1]), aliases.meaning(title))
        for title, values in arrays.items()
    ]
    return [
        _log(f"{path.name}_{int(e)}", [_rows(c, np.flatnonzero(episode == e)) for c in columns], info, unread)
        for e in np.unique(episode)
    ]


def _rows(c: Column, rows: np.ndarray) -> Column:
    return Column(c.title, c.values[rows], c.parts, c.means)


def _info(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MAX_INFO:
            raise InputError(f"{path} is larger than {MAX_INFO >> 20} MB.")
        info = json.loads(path.read_text(encoding="utf-8"))
        info["fps"] = float(info["fps"])
        if not (isinstance(info["features"], dict) and 0 < info["fps"] < 1e6):
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{path} is damaged: it needs 'fps' and 'features'.") from None
    return dict(info)


def _read_files(files: list[Path], features: dict[str, Any]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Numeric columns [T, n] of all files one after another, and what else there is."""
    pieces: dict[str, list[np.ndarray]] = {}
    unread = [t for t, f in features.items() if f.get("dtype") in ("video", "image")]
    total = 0
    for file in files:
        with extra("pyarrow.parquet", "lerobot").ParquetFile(file) as source:
            _check(file, source.metadata)
            titles = [f.name for f in source.schema_arrow if f.name not in unread and _is_numeric(f.type)]
            unread += [f.name for f in source.schema_arrow if f.name not in (*titles, *unread)]
            for batch in source.iter_batches(BATCH, columns=titles):
                for title in titles:
                    values = _matrix(file, title, batch.column(title))
                    total += values.size
                    check_values(file.name, title, total)
                    pieces.setdefault(title, []).append(values)
    rows = sum(len(v) for v in next(iter(pieces.values()), []))
    out = {}
    for title, found in pieces.items():
        if len({v.shape[1] for v in found}) == 1 and sum(map(len, found)) == rows:
            out[title] = np.concatenate(found)
        else:
            unread.append(title)
    return out, unread


def _check(file: Path, metadata: Any) -> None:
    """Refuse, by what the file states, rows that would fill the memory."""
    check_values(file.name, "rows", int(metadata.num_rows))
    for g in range(metadata.num_row_groups):
        # not column by column: asked for a damaged one, pyarrow ends the process
        check_bytes(file.name, "a group of rows", int(metadata.row_group(g).total_byte_size))


def _is_numeric(kind: Any) -> bool:
    types = extra("pyarrow.types", "lerobot")
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        kind = kind.value_type
    return bool(types.is_floating(kind) or types.is_integer(kind) or types.is_boolean(kind))


def _matrix(file: Path, title: str, column: Any) -> np.ndarray:
    """Rows of numbers, or of lists of equally many numbers, as [T, n]."""
    rows, flat = len(column), column
    if hasattr(flat.type, "value_type"):
        lengths = extra("pyarrow.compute", "lerobot").list_value_length(flat)
        widths = np.unique(np.asarray(lengths.to_numpy(zero_copy_only=False), dtype=float))
        if rows and (widths.size != 1 or not widths[0] > 0):
            raise InputError(f"{file.name}: rows of '{title}' hold different numbers of values.")
        flat = flat.flatten()
    values = np.asarray(flat.to_numpy(zero_copy_only=False), dtype=float)
    return values.reshape(rows, -1) if rows else np.zeros((0, 1))


def _parts(feature: dict[str, Any], width: int) -> tuple[str, ...] | None:
    """Names of an array's columns: a list, or as older datasets have it a list in a dictionary."""
    names = feature.get("names")
    if isinstance(names, dict):
        names = next((v for v in names.values() if isinstance(v, list)), None)
    if isinstance(names, list) and len(names) == width and width > 1:
        return tuple(map(str, names))
    return None


def _log(name: str, columns: list[Column], info: dict[str, Any], unread: list[str]) -> Log:
    by_title = {c.title: c for c in columns}
    frame = by_title.get("frame_index")
    order = (
        np.arange(len(columns[0].values)) if frame is None else np.argsort(frame.values[:, 0], kind="stable")
    )
    columns = [_rows(c, order) for c in columns]
    index = np.arange(order.size, dtype=float) if frame is None else frame.values[order, 0]
    made_up, time = index / info["fps"], by_title.get("timestamp")
    stamps = None if time is None else time.values[order, 0]
    if stamps is None or np.allclose(stamps - stamps[0], made_up - made_up[0], atol=0.02 / info["fps"]):
        # float32 stamps, so the quotient is the more precise of the two
        table = Table("", tuple(columns), made_up, SYNTHETIC)
        return Log(name, (table,), (SAID,), tuple(unread))
    return Log(name, (Table("", tuple(columns), stamps, "its own timestamps"),), (), tuple(unread))
