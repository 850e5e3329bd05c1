"""The folder of a sweep: what was asked, what every cell gave, atomically written, never mixed with another sweep's."""

import csv
import dataclasses
import io
import json
import os
import platform
import shutil
import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import Any

import flax.traverse_util
import jax
import jax.numpy as jnp
import numpy as np

from mpge_jax import files
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.loop import Curve
from mpge_jax.rollouts import policies
from mpge_jax.rollouts.policies import PolicySet

ROOT = Path(__file__).resolve().parents[1]
_PACKAGES = (
    "jax",
    "jaxlib",
    "mujoco",
    "mujoco-mjx",
    "flax",
    "optax",
    "orbax-checkpoint",
    "gymnasium",
    "numpy",
)


def plain(value: Any) -> Any:
    """`value` as JSON holds it: dataclasses and mappings as dicts, tuples as lists."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"kind": type(value).__name__, **fields}
    if isinstance(value, dict):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def versions() -> dict[str, str]:
    """The project's commit, versions of what else results depend on, and the kind of machine."""
    return {
        "commit": commit(),
        "python": platform.python_version(),
        **{name: version(name) for name in _PACKAGES},
        "machine": machine(),
    }


def machine() -> str:
    """The kind of machine: system, processors, and what JAX computes on."""
    device = jax.devices()[0]
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, {device.device_kind}"


def commit(root: Path = ROOT) -> str:
    """The commit that `root` is a checkout of, with `-dirty` where files differ from it; "none" where it is not one."""
    if not (root / ".git").exists():
        return "none"
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "none"


class SweepFolder:
    """The output folder of one sweep.

    Args:
      path: the folder; made where there is none.
      identity: what all cells share; a folder of another sweep is refused.

    Raises:
      ValueError: the folder holds another sweep, or something that is not a sweep.
    """

    def __init__(self, path: Path, identity: dict[str, Any]):
        self.path, self.identity = path, identity
        record = path / "sweep.json"
        if record.is_file():
            try:
                found = dict(json.loads(record.read_text())["identity"])
            except (ValueError, KeyError, TypeError) as error:
                raise ValueError(
                    f"{record} cannot be read; move the folder away or choose another --out"
                ) from error
            differing = sorted(k for k in {*found, *identity} if found.get(k) != identity.get(k))
            if differing:
                raise ValueError(
                    f"{path} holds another sweep ({', '.join(differing)} differ); choose another --out"
                )
        elif path.exists() and not _is_fresh(path):
            raise ValueError(f"{path} is not empty and holds no sweep; choose another --out")
        else:
            files.write_text(record, json.dumps({"identity": identity, "versions": versions()}, indent=1))

    def check_inputs(self, inputs: dict[str, int]) -> None:
        """Records what cells start from, by its name and checksum.

        Raises:
          ValueError: cells before started from something else.
        """
        file = self.path / "inputs.json"
        before = json.loads(file.read_text()) if file.is_file() else {}
        changed = [what for what, checksum in inputs.items() if before.get(what, checksum) != checksum]
        if changed:
            raise ValueError(
                f"changed since the sweep in {self.path} began: {', '.join(changed)}; choose another --out"
            )
        if not inputs.keys() <= before.keys():
            files.write_text(file, json.dumps({**before, **inputs}, indent=1))

    def cell(self, method: str, samples: int) -> Path:
        """Where a cell keeps its files."""
        return self.path / "cells" / f"{method}-{samples}"

    def result(self, method: str, samples: int) -> Path:
        """The file that a finished cell has."""
        return self.cell(method, samples) / "result.json"

    def save_cell(
        self,
        method: str,
        samples: int,
        rows: list[dict[str, Any]],
        curve: Curve,
        transformers: Transformer | None,
        agents: PolicySet,
    ) -> None:
        """Stores a cell beside its target logs; the result last, so that a cell with a result is complete.

        Drops its checkpoints.
        """
        folder = self.cell(method, samples)
        folder.mkdir(parents=True, exist_ok=True)
        # a sweep may go on with a later version of the code, and elsewhere
        made = {"commit": commit(), "machine": machine()}
        rows = [{**row, **made} for row in rows]
        if transformers is not None:
            leaves, _ = jax.tree_util.tree_flatten_with_path(transformers)
            arrays = {
                jax.tree_util.keystr(path, simple=True, separator="/"): np.asarray(x) for path, x in leaves
            }
            files.write_npz(folder / "transformers.npz", arrays)
        if curve:
            files.write_npz(folder / "curve.npz", curve)
        policies.save(folder / "agents.npz", agents, {"rows": rows})
        files.write_text(self.result(method, samples), json.dumps(rows, indent=1))
        (folder / "error.json").unlink(missing_ok=True)
        for checkpoints in self._checkpoints(folder):
            shutil.rmtree(checkpoints, ignore_errors=True)

    def transformers(self, method: str, samples: int) -> Transformer | None:
        """The transformers of a finished cell, every leaf `[S, N, ...]`; None where it has none."""
        file = self.cell(method, samples) / "transformers.npz"
        if not file.is_file():
            return None
        arrays = {name: jnp.asarray(value) for name, value in files.read_npz(file).items()}
        return Transformer(**flax.traverse_util.unflatten_dict(arrays, sep="/"))

    def agents(self, method: str, samples: int) -> PolicySet | None:
        """The deployed policies of a finished cell, one a seed; None where they were not kept."""
        file = self.cell(method, samples) / "agents.npz"
        return policies.load(file)[0] if file.is_file() else None

    def save_error(self, method: str, samples: int, message: str) -> None:
        """Records why a cell failed."""
        files.write_text(self.cell(method, samples) / "error.json", json.dumps({"error": message}, indent=1))

    def begun(self, method: str, samples: int) -> bool:
        """Whether a run of a cell was interrupted that a new one goes on from."""
        return any(path.exists() for path in self._checkpoints(self.cell(method, samples)))

    @staticmethod
    def _checkpoints(cell: Path) -> list[Path]:
        return [cell / "grounding", cell / "agent", *cell.glob("seed_*")]

    def rows_of(self, method: str, samples: int) -> list[dict[str, Any]]:
        """The results of a finished cell, one row a seed."""
        return list(json.loads(self.result(method, samples).read_text()))

    def rows(self) -> list[dict[str, Any]]:
        """The results of all finished cells, one row a seed."""
        return [
            row
            for file in sorted((self.path / "cells").glob("*/result.json"))
            for row in json.loads(file.read_text())
        ]

    def curves(self) -> dict[tuple[str, int], Curve]:
        """The learning curves of all finished cells that have one."""
        found = {}
        for file in sorted((self.path / "cells").glob("*/curve.npz")):
            method, samples = file.parent.name.rsplit("-", 1)
            found[method, int(samples)] = files.read_npz(file)
        return found

    def write_tables(self, markdown: str) -> None:
        """`results.csv` and `results.json` of all rows, and `results.md`."""
        rows = self.rows()
        names = list(dict.fromkeys(name for row in rows for name in row))
        table = io.StringIO(newline="")
        writer = csv.DictWriter(table, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        files.write_text(self.path / "results.csv", table.getvalue())
        record = json.loads((self.path / "sweep.json").read_text())
        files.write_text(self.path / "results.json", json.dumps({**record, "rows": rows}, indent=1))
        files.write_text(self.path / "results.md", markdown)


def _is_fresh(path: Path) -> bool:
    # A sweep killed in its first moment leaves nothing but a half-written record and its lock.
    return path.is_dir() and all(file.name in ("sweep.json.partial", ".lock") for file in path.iterdir())
