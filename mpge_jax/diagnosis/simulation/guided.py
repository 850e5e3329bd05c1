"""Joints that move as they were recorded, whatever drives them: what acts there does not matter to the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from mujoco.batch import Batch

from mpge_jax.diagnosis.recordings.kalman_smoother import Series, drawn
from mpge_jax.diagnosis.recordings.states import Noise
from mpge_jax.diagnosis.simulation.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
HEAVY = 1e6
"""Inertia of a guided joint, in its own: no other force changes its acceleration beyond that share."""


def unseen(s: Source, model: mujoco.MjModel, dofs: Sequence[int]) -> Source:
    """A recording in which some hinges or slides, which move as their smoothed states do, count as unmeasured."""
    r, qpos = s.recording, s.recording.qpos.copy()
    qvel = None if r.qvel is None else r.qvel.copy()
    qpos[:, model.jnt_qposadr[model.dof_jntid[list(dofs)]]] = np.nan
    if qvel is not None:
        qvel[:, list(dofs)] = np.nan
    return replace(s, recording=replace(r, qpos=qpos, qvel=qvel))


def as_it_may_have_moved(
    s: Source, model: mujoco.MjModel, noise: Noise, dofs: Sequence[int], rng: np.random.Generator
) -> Source:
    """A recording whose hinges and slides moved as smoothed, but for what measurements leave open of that: a draw."""
    q, v, rows = s.states.qpos.copy(), s.states.qvel.copy(), s.recording.time.size
    at = model.jnt_qposadr[model.dof_jntid[list(dofs)]]
    series = []
    for column, dof in zip(at, dofs, strict=True):
        sigma, sigma_v = np.hypot(noise.qpos[column], noise.stamp * np.abs(v[:, dof])), float(noise.qvel[dof])
        position = q[:, column] + sigma * rng.standard_normal(rows)
        velocity = v[:, dof] + sigma_v * rng.standard_normal(rows) if np.isfinite(sigma_v) else None
        series.append(Series(s.recording.time, position, velocity, sigma, min(sigma_v, 1.0)))
    for column, dof, moved in zip(at, dofs, drawn(series, rng), strict=True):
        q[:, column], v[:, dof] = moved[:, 0], moved[:, 1]
    return replace(s, states=replace(s.states, qpos=q, qvel=v))


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
