"""Fields of the model, of some simulations of a batch."""

from __future__ import annotations

from typing import Any

import numpy as np
from mujoco.batch import Batch

from mpge_jax.diagnosis.effects.step import Fields

Array = np.ndarray


class BatchFields(Fields):
    """Model fields of some simulations of a batch."""

    xp = np

    def __init__(self, batch: Batch, rows: Array) -> None:
        self.batch, self.rows = batch, rows

    def get(self, name: str, index: Any) -> Array:
        index = index if isinstance(index, tuple) else (index,)
        return np.array(self.batch.expand(name)[self._at(index)], dtype=float)

    def set(self, name: str, index: Any, value: Any) -> None:
        index = index if isinstance(index, tuple) else (index,)
        self.batch.expand(name)[self._at(index)] = value

    def _at(self, index: tuple[Any, ...]) -> tuple[Any, ...]:
        if any(isinstance(i, slice) for i in index):
            return (self.rows, *index)
        return (self.rows, *(np.full(self.rows.shape, i) for i in index))
