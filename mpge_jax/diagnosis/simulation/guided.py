"""Joints that move as they were recorded, whatever drives them: what acts there does not matter to the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from mujoco.batch import Batch

from mpge_jax.diagnosis.recordings.kalman_smoother import Series, errors_drawn
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
MOTIONS = 16
"""Motions that a guided joint may have had: what others do with them is no missing physics."""
HEAVY = 1e6
"""Inertia of a guided joint, in its own: no other force changes its acceleration beyond that share."""


def led(
    s: Source, model: mujoco.MjModel, noise: Noise, dofs: Sequence[int], rng: np.random.Generator
) -> Source:
    """A recording in which some hinges or slides move as their smoothed states do and count as unmeasured, with motions
    that they may have had as well, for all that was measured of them."""
    r, qpos, at = s.recording, s.recording.qpos.copy(), model.jnt_qposadr[model.dof_jntid[list(dofs)]]
    qvel = None if r.qvel is None else r.qvel.copy()
    qpos[:, at] = np.nan
    if qvel is not None:
        qvel[:, list(dofs)] = np.nan
    series, joints = [], list(dofs)
    for column, dof in zip(at, dofs, strict=True):
        q, v = s.states.qpos[:, column], s.states.qvel[:, dof]
        sigma, sigma_v = np.hypot(noise.qpos[column], noise.stamp * np.abs(v)), float(noise.qvel[dof])
        position = q + sigma * rng.standard_normal(q.size)
        velocity = v + sigma_v * rng.standard_normal(v.size) if np.isfinite(sigma_v) else None
        series.append(Series(r.time, position, velocity, sigma, min(sigma_v, 1.0)))
    otherwise = []
    # states that are taken as measured are as well known as that
    for error in () if noise.direct else np.stack(errors_drawn(series, MOTIONS, rng), 2):
        q, v = s.states.qpos.copy(), s.states.qvel.copy()
        q[:, at] += error[..., 0]
        v[:, joints] += error[..., 1]
        otherwise.append(replace(s.states, qpos=q, qvel=v))
    return replace(s, recording=replace(r, qpos=qpos, qvel=qvel), otherwise=tuple(otherwise))


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
