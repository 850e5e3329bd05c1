"""What was simulated before, so that it is not simulated twice."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Sequence

import numpy as np

Array = np.ndarray
ROOM = 256_000_000
"""Bytes that are kept."""


class Remembered:
    """Residuals by what was simulated; where there is no room, those go that were not asked for longest."""

    def __init__(self, room: int = ROOM) -> None:
        self.room, self.used = room, 0
        self._kept: OrderedDict[Hashable, tuple[Array, object]] = OrderedDict()

    def recall(self, keys: Sequence[Hashable], out: Array) -> list[int]:
        """Write what is known into the rows of `out` [R, ...]; returns the others, of equal keys the first."""
        new: dict[Hashable, int] = {}
        for i, key in enumerate(keys):
            if key in self._kept:
                self._kept.move_to_end(key)
                out[i] = self._kept[key][0]
            else:
                new.setdefault(key, i)
        return list(new.values())

    def keep(self, keys: Sequence[Hashable], out: Array, new: Sequence[int], held: object) -> None:
        """Remember the `new` rows of `out`, and write them to those with the same key.

        Args:
            held: what keys name by its `id`: kept as long as they are.
        """
        first = {keys[i]: i for i in new}
        for i, key in enumerate(keys):
            if key in first and first[key] != i:
                out[i] = out[first[key]]
        for i in new:
            self._kept[keys[i]] = out[i].copy(), held
            self.used += out[i].nbytes
        while self.used > self.room:
            self.used -= self._kept.popitem(last=False)[1][0].nbytes
