"""What the cells of a sweep start from beside its settings: policy sets, and models of tasks of the user's own. A sweep
that goes on must start from the same."""

import zlib
from collections.abc import Sequence

import mujoco
import numpy as np

import envs
from envs import own_tasks
from experiments.methods import METHODS, Cell
from mpge_jax.rollouts import policies


def inputs_of(cells: Sequence[Cell]) -> dict[str, int]:
    """A checksum of each, by what it is called in messages."""
    task = cells[0].task
    source, coefficient = envs.source_of(task), cells[0].preset.entropy_coefficient
    kinds = dict.fromkeys(METHODS[cell.method].kind for cell in cells)
    sets = {kind: policies.shipped_path(source, kind, coefficient) for kind in kinds}
    out = {
        f"the {kind} policies of {source}": zlib.crc32(path.read_bytes())
        for kind, path in sets.items()
        if path.is_file()
    }
    if own_tasks.split(task) is not None:
        out |= {f"the model of {name}": _model(name, cells[0]) for name in (source, envs.plain_name(task))}
    return out


def _model(name: str, cell: Cell) -> int:
    model = envs.make(name, cell.backend, cell.dynamics).model
    stored = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, stored)
    return zlib.crc32(stored.tobytes())
