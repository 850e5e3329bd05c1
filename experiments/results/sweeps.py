"""What a sweep left in its folder, read."""

import json
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.methods import METHODS
from experiments.methods.grounded import grounded
from experiments.storage import SweepFolder
from mpge_jax import files
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.loop import Curve

PICTURES = {
    "errors": "Action-transformation error",
    "heat_map": "Action-transformation error along each rollout policy",
}


@dataclass(frozen=True)
class Sweep:
    """What a sweep left in its folder.

    Attributes:
      name: of the folder.
      identity: what all its cells share.
      versions: of packages, and the machine.
      rows: one for each method, number of samples and seed.
      curves: of grounding, by method and samples.
      failures: what each cell that failed raised.
      pictures: that it drew.
      along_policies: errors of its transformers along every rollout policy (`heat_map`), where they were measured.
      grounded_returns: of its agents in their grounded simulators (`grounded_returns`), where they were measured.
    """

    name: str
    identity: dict[str, Any]
    versions: dict[str, str]
    rows: list[dict[str, Any]]
    curves: dict[tuple[str, int], Curve]
    failures: dict[str, str]
    pictures: list[Path]
    along_policies: dict[str, Any] | None = None
    grounded_returns: dict[str, Any] | None = None

    @property
    def command(self) -> str:
        """The command line that makes this sweep."""
        i = self.identity
        samples = sorted({row["samples"] for row in self.rows if row["samples"]})
        words = ["python", "-m", "experiments.sweep", "--task", i["task"]]
        words += ["--method", *(m for m in METHODS if any(row["method"] == m for row in self.rows))]
        words += ["--samples", *map(str, samples)] if samples else []
        words += ["--seeds", str(i["seeds"]), "--preset", i["preset"]["name"]]
        for option, usual in (("backend", "auto"), ("dynamics", "mujoco")):
            words += [f"--{option}", i[option]] if i[option] != usual else []
        return shlex.join(words)


def read_json(path: Path) -> Any:
    """The content of a file.

    Raises:
      ValueError: it cannot be read; says which.
    """
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read ({type(error).__name__}: {error})") from error


def read_sweep(folder: Path) -> Sweep:
    """Reads a sweep's folder.

    Raises:
      ValueError: a file of it is damaged; says which.
    """
    record = read_json(folder / "results.json")
    curves = {}
    for file in sorted((folder / "cells").glob("*/curve.npz")):
        method, samples = file.parent.name.rsplit("-", 1)
        try:
            with np.load(file, allow_pickle=False) as arrays:
                curves[method, int(samples)] = {name: arrays[name] for name in arrays.files}
        except Exception as error:
            raise ValueError(f"{file} is damaged ({type(error).__name__}: {error})") from error
    failures = {
        file.parent.name: _summary(read_json(file)["error"])
        for file in sorted((folder / "cells").glob("*/error.json"))
        if not (file.parent / "result.json").exists()
    }
    if "target_log" in record.get("identity", {}):
        raise ValueError(f"{folder} was made from a recorded log and has no returns; read its own results.md")
    try:
        return Sweep(
            name=folder.resolve().name,
            identity=record["identity"],
            versions=record["versions"],
            rows=record["rows"],
            curves=curves,
            failures=failures,
            pictures=[folder / f"{name}.png" for name in PICTURES if (folder / f"{name}.png").is_file()],
            along_policies=_measured(folder, "heat_map", "steps"),
            grounded_returns=_measured(folder, "grounded_returns", "episodes"),
        )
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"{folder / 'results.json'} is not what a sweep writes: {error} is missing"
        ) from error


def keep_measured(folder: Path, name: str, record: dict[str, Any]) -> None:
    """Keeps what a command of that name measured of a sweep.

    Raises:
      ValueError: there was no cell to measure.
    """
    if not record["cells"]:
        raise ValueError(f"no cell of {folder} has transformers; run a method that grounds.")
    files.write_text(folder / f"{name}.json", json.dumps(record, indent=1))


def grounded_cells(sweep: SweepFolder) -> Iterator[tuple[str, int, Transformer]]:
    """Method, samples and transformers `[S, N, ...]` of every cell that has some, but for those that were learned in a
    corrected simulator, which do not belong before the plain one."""
    for method, samples in sorted({(row["method"], row["samples"]) for row in sweep.rows()}, key=order):
        made = sweep.transformers(method, samples)
        if made is not None and METHODS[method].work is grounded:
            yield method, samples, made


def _measured(folder: Path, name: str, amount: str) -> dict[str, Any] | None:
    """What a command of that name measured of the sweep, with the `amount` it took; None where it did not run."""
    file = folder / f"{name}.json"
    record = read_json(file) if file.is_file() else None
    if record is not None and not {"cells", amount, "versions"} <= set(record):
        raise ValueError(f"{file} is not what {name} writes; run it again")
    return record


def _summary(trace: str) -> str:
    """What was raised, from a traceback; XLA's messages go on over many lines, of which the first tells most."""
    lines = trace.strip().splitlines()
    raised = [line for line in lines if re.match(r"[A-Za-z_][\w.]*(: |$)", line)]
    return (raised or lines)[-1]


def order(cell: tuple[str, int]) -> tuple[int, int]:
    """Where a method and its samples stand in a table: methods in their own order, then by samples."""
    method, samples = cell
    return list(METHODS).index(method), samples
