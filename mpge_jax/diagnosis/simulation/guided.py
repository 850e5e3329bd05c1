"""Joints that move as they were recorded, whatever drives them: what acts there does not matter to the others."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch

from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
HEAVY = 1e6
"""Inertia of a guided joint, in its own: no other force changes its acceleration beyond that share."""


class Guide:
    """Gives some degrees of freedom (of hinges and slides) the recorded acceleration, speed and position in each step
    of a batch. The other joints feel all three, as they did when it was recorded."""

    def __init__(
        self, model: mujoco.MjModel, batch: Batch, w: Windows, window: Array, dofs: tuple[int, ...]
    ) -> None:
        self.dofs, self.dt = list(dofs), w.dt
        self.qpos, self.qvel, self.force = (batch.bind(k) for k in ("qpos", "qvel", "qfrc_applied"))
        self.qadr = [int(model.jnt_qposadr[model.dof_jntid[d]]) for d in dofs]
        self.inertia = HEAVY * model.dof_M0[self.dofs]
        batch.expand("dof_armature")[:, self.dofs] += self.inertia
        times = w.start[:, None] + w.dt * np.arange(w.steps + 1)
        q, v = np.empty((2, *times.shape, len(dofs)))
        for source in np.unique(w.source):
            here = w.source == source
            for i, (qadr, dof) in enumerate(zip(self.qadr, dofs, strict=True)):
                q[here, :, i], v[here, :, i] = w.sources[source].state_at(times[here], qadr, dof)
        self.q, self.v = q[window], v[window]

    def push(self, k: int) -> None:
        """Add the force of step k to those that are applied."""
        acceleration = (self.v[:, k + 1] - self.v[:, k]) / self.dt
        self.force[:, self.dofs] += self.inertia * acceleration

    def place(self, k: int) -> None:
        """Put the joints where they were after k steps."""
        self.qpos[:, self.qadr] = self.q[:, k]
        self.qvel[:, self.dofs] = self.v[:, k]
