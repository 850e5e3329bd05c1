"""What a diagnosis costs, by joints and rows, from measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.scale.costs import Diagnosis
from experiments.scale.robots import Robots
from mpge_jax.diagnosis import Config

_C = Config()
FULL = round((_C.train_windows + _C.choice_windows) * _C.decide_s * Robots.rate)
"""Rows that fill the windows of a search. Below, the search itself grows with the data, and the model says nothing."""


@dataclass(frozen=True)
class CostModel:
    """CPU seconds and memory of a diagnosis of much data: the search, that the joints decide, and what each row takes.

    Attributes:
      search: CPU seconds, by joints.
      per_row: CPU seconds a row and joint.
      mb_per_row: 10^6 bytes of memory a row and joint.
    """

    search: dict[int, float]
    per_row: float
    mb_per_row: float

    def cpu_seconds(self, joints: int, rows: int) -> float:
        """Of a diagnosis of a robot with that many joints, as were measured, and rows."""
        return self.search[joints] + self.per_row * joints * rows


def fitted(rows: list[Diagnosis]) -> CostModel:
    """Slopes by least squares within robots of as many joints, through the smallest log of each that fills the windows;
    none below nothing. Robots of which no log does are left out."""
    least: dict[int, Diagnosis] = {}
    full = sorted((r for r in rows if r.rows >= FULL), key=lambda r: (r.joints, r.rows))
    for r in full:
        least.setdefault(r.joints, r)
    x = np.array([r.joints * (r.rows - least[r.joints].rows) for r in full], float)
    cpu = np.array([r.cpu_seconds - least[r.joints].cpu_seconds for r in full])
    memory = np.array([r.peak_mb - least[r.joints].peak_mb for r in full])
    square = max(float(x @ x), 1.0)
    per_row, mb_per_row = (max(float(x @ y) / square, 0.0) for y in (cpu, memory))
    search = {joints: r.cpu_seconds - per_row * joints * r.rows for joints, r in least.items()}
    return CostModel(search, per_row, mb_per_row)
