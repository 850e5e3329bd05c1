"""How many steps may be simulated as one where only what a change of the model does is asked for."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.machine.joint_space import difference
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.windows import Windows

STRIDES = (4, 3, 2)
LEAST_STEPS = 25
"""Larger steps that a window must have."""
ALIKE = 0.02
"""Share of a joint's motion by which the model as given may move otherwise in larger steps."""
STILL = 1e-5
"""Motion (rad or m) that is none."""


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


def _size(x: np.ndarray) -> np.ndarray:
    """Root of the mean square [nv] over windows and samples [W, N, nv], 0 where nothing is measured."""
    return np.sqrt(np.nan_to_num(np.nansum(x**2, (0, 1)) / np.maximum(np.isfinite(x).sum((0, 1)), 1)))
