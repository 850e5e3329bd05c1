"""Runs near a known one, told from it by cheaper steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray


@dataclass(frozen=True)
class Near:
    """Residuals near those of a known run. Where cheaper steps show what a change does, only the known run is simulated
    in the model's own: the others are told from it by those.

    Attributes:
        offset: [W, N, 2 nv] by how much the two differ for the known run; None where there is one kind of steps.
    """

    sim: Simulator
    w: Windows
    offset: Array | None

    @staticmethod
    def to(sim: Simulator, known: Run, w: Windows) -> Near:
        offset = sim.residuals([known], w)[0] - sim.cheaply([known], w)[0] if sim.costly(w) else None
        return Near(sim, w, offset)

    def residuals(self, runs: list[Run]) -> Array:
        """[R, W, N, 2 nv], as `Simulator.residuals`."""
        if self.offset is None:
            return self.sim.residuals(runs, self.w)
        out = self.sim.cheaply(runs, self.w)
        out[[not run.hypothesis.rugged for run in runs]] += self.offset
        return out


def changes(sim: Simulator, runs: list[Run], w: Windows) -> Array:
    """What each run but the first changes of its residuals, [R - 1, W, N, 2 nv]: in cheaper steps where these tell."""
    res = sim.cheaply(runs, w) if sim.costly(w) else sim.residuals(runs, w)
    return res[1:] - res[0]
