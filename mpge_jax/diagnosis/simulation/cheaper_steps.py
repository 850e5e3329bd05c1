"""Runs near a known one, told from it by cheaper steps; and how many steps may be one of these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.machine.joint_space import difference
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
STRIDES = (4, 3, 2)
LEAST_STEPS = 25
"""Larger steps that a window must have."""
ALIKE = 0.02
"""Share of a joint's motion by which the model as given may move otherwise in larger steps."""
STILL = 1e-5
"""Motion (rad or m) that is none."""


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
        out[~self.sim.own_steps(runs, self.w)] += self.offset
        return out


def changes(sim: Simulator, runs: list[Run], w: Windows) -> Array:
    """What each run but the first changes of its residuals, [R - 1, W, N, 2 nv]: in cheaper steps where these tell."""
    res = sim.cheaply(runs, w) if sim.costly(w) else sim.residuals(runs, w)
    return res[1:] - res[0]


def stride(sim: Simulator, w: Windows) -> int:
    """The largest stride in which the model as given moves nearly as in its own steps, at every degree of freedom by
    itself; 1 with contacts, where each step decides."""
    if sim.ctx.contacts or not w.count:
        return 1
    nv, run = sim.model.nv, [Run(Hypothesis(), np.zeros(0))]
    start = np.broadcast_to(w.q0[:, None], w.qpos.shape)
    allowed = np.maximum(ALIKE * _size(difference(sim.model, start, w.qpos)), STILL)
    own = sim.residuals(run, w)[0, ..., :nv]
    for factor in STRIDES:
        if w.steps < LEAST_STEPS * factor:
            continue
        larger = sim.residuals(run, w.in_larger_steps(factor))[0, ..., :nv]
        if (_size(larger - own) <= allowed).all():
            return factor
    return 1


def _size(x: Array) -> Array:
    """Root of the mean square [nv] over windows and samples [W, N, nv], 0 where nothing is measured."""
    return np.sqrt(np.nan_to_num(np.nansum(x**2, (0, 1)) / np.maximum(np.isfinite(x).sum((0, 1)), 1)))
