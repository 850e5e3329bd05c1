"""What runs took, from the files that they left, as rows of CSV files."""

from __future__ import annotations

import csv
import io
import json
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import mujoco
import numpy as np

from experiments.runners.job import COST
from mpge_jax import files


@dataclass(frozen=True)
class Diagnosis:
    """One robot of a fleet: what it was given (`rows` of all `runs` together, of `bytes` on disk), what it took, and
    what it left (`files`, `bytes_left`)."""

    joints: int
    runs: int
    rows: int
    bytes: int
    effects: int
    seconds: float
    cpu_seconds: float
    peak_mb: float
    files: int
    bytes_left: int
    machine: str


@dataclass(frozen=True)
class CellCost:
    """One cell of a sweep, all its seeds together; `cpu_seconds` and `peak_mb` are NaN where it ran before they were
    noted."""

    preset: str
    task: str
    method: str
    samples: int
    seeds: int
    seconds: float
    cpu_seconds: float
    peak_mb: float
    machine: str


@dataclass(frozen=True)
class Jobs:
    """`jobs` that do nothing, on a runner, with `workers` where it is local: by the clock of the one that waits, with
    `load` processes that wanted a core (mean of the last minute)."""

    runner: str
    workers: int
    jobs: int
    seconds: float
    load: float
    machine: str


@dataclass(frozen=True)
class Comparison:
    """Reading and comparing the diagnoses of `robots`, and writing the pages."""

    robots: int
    effects: int
    seconds: float
    cpu_seconds: float
    peak_mb: float
    machine: str


Row = TypeVar("Row", Diagnosis, CellCost, Jobs, Comparison)
NAMES: dict[type, str] = {
    Diagnosis: "diagnoses.csv",
    CellCost: "cells.csv",
    Jobs: "jobs.csv",
    Comparison: "comparisons.csv",
}


def machine() -> str:
    """The kind of machine this is."""
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"


def of_fleet(folder: Path, model: Path, robots: Path) -> list[Diagnosis]:
    """The robots of a fleet that was diagnosed, in one go each.

    Args:
      folder: its --out. model, robots: what it was given.

    Raises:
      ValueError: no robot in it was.
    """
    joints = mujoco.MjModel.from_xml_path(str(model)).nv
    found = [_diagnosis(cost.parent, robots / cost.parent.name, joints) for cost in _costs(folder / "robots")]
    if not found:
        raise ValueError(f"{folder} holds no robot that was diagnosed")
    return found


def _costs(folder: Path) -> list[Path]:
    return sorted(folder.glob(f"*/{COST}"))


def _diagnosis(out: Path, recordings: Path, joints: int) -> Diagnosis:
    cost = json.loads((out / COST).read_text())
    recorded = sorted(recordings.glob("*.npz"))
    left = [path for path in out.rglob("*") if path.is_file()]
    return Diagnosis(
        joints=joints,
        runs=len(recorded),
        rows=sum(len(_times(path)) for path in recorded),
        bytes=sum(path.stat().st_size for path in recorded),
        effects=len(json.loads((out / "effects.json").read_text())["effects"]),
        files=len(left),
        bytes_left=sum(path.stat().st_size for path in left),
        machine=machine(),
        **cost,
    )


def _times(path: Path) -> np.ndarray:
    with np.load(path, allow_pickle=False) as arrays:
        return np.asarray(arrays["time"])


def of_sweep(folder: Path) -> list[CellCost]:
    """The cells of a sweep.

    Raises:
      ValueError: it has no results.
    """
    try:
        record = json.loads((folder / "results.json").read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{folder / 'results.json'} cannot be read ({error})") from error
    groups: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for row in record["rows"]:
        groups.setdefault((row["method"], row["samples"]), []).append(row)
    return [_cell(folder, record, rows) for _, rows in sorted(groups.items())]


def _cell(folder: Path, record: dict[str, Any], rows: list[dict[str, Any]]) -> CellCost:
    first = rows[0]
    cost = folder / "cells" / f"{first['method']}-{first['samples']}" / COST
    known = json.loads(cost.read_text()) if cost.exists() else {}
    return CellCost(
        preset=record["identity"]["preset"]["name"],
        task=first["task"],
        method=first["method"],
        samples=first["samples"],
        seeds=len(rows),
        seconds=round(sum(row["seconds"] for row in rows), 1),
        cpu_seconds=known.get("cpu_seconds", float("nan")),
        peak_mb=known.get("peak_mb", float("nan")),
        machine=record["versions"]["machine"],
    )


def read(kind: type[Row], folder: Path) -> list[Row]:
    """The rows that were kept, none where there is no file."""
    path = folder / NAMES[kind]
    if not path.exists():
        return []
    types: dict[str, Any] = {f.name: {"int": int, "float": float}.get(str(f.type), str) for f in fields(kind)}
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [kind(**{name: types[name](value) for name, value in row.items()}) for row in rows]


def add(rows: Sequence[Row], folder: Path) -> Path:
    """Keeps rows beside those that are kept; of two of the same thing the new one."""
    kind: type[Row] = type(rows[0])
    kept = {_what(row): row for row in [*read(kind, folder), *rows]}
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, [f.name for f in fields(kind)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(kept[what]) for what in sorted(kept))
    path = folder / NAMES[kind]
    files.write_text(path, text.getvalue())
    return path


def _what(row: Diagnosis | CellCost | Jobs | Comparison) -> tuple[Any, ...]:
    """What a row measured, by which its kind is sorted."""
    if isinstance(row, Diagnosis):
        return row.joints, row.runs, row.rows
    if isinstance(row, CellCost):
        return row.preset, row.task, row.method, row.samples
    if isinstance(row, Jobs):
        return row.runner, row.workers, row.jobs
    return (row.robots,)
