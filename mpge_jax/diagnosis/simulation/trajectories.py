"""Trajectories of many simulations: by the engine alone, or with forces that are computed at each step."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from mujoco.batch import Batch

from mpge_jax.diagnosis.machine.model import is_scalar
from mpge_jax.diagnosis.simulation.driving.drive_signal import hermite
from mpge_jax.diagnosis.simulation.guided import Guide
from mpge_jax.diagnosis.simulation.run_up import run_up
from mpge_jax.diagnosis.simulation.runtime_effects import DIVERGED, Runtime, diverged
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray


@dataclass(frozen=True)
class Commands:
    """Commands of n simulations of windows.

    Attributes:
        window: [n] of each simulation. changed: actuator -> (rows, [rows, H + K]) where they are not the windows'.
    """

    w: Windows
    window: Array
    changed: dict[int, tuple[Array, Array]] = field(default_factory=dict)

    def __call__(self, k: int) -> Array:
        """[n, nu] in step k, negative before the start."""
        return self._of(self.w.history + k)

    def along(self) -> Array:
        """[n, K, nu] in all steps."""
        return self._of(slice(self.w.history, None))

    def _of(self, steps: int | slice) -> Array:
        out = self.w.command[:, steps].take(self.window, 0)
        for a, (rows, u) in self.changed.items():
            out[rows, ..., a] = u[:, steps]
        return out


def by_the_engine(batch: Batch, commands: Commands, pushes: dict[int, Array]) -> tuple[Array, Array]:
    """States [K + 1, n, nq], [K + 1, n, nv] along the windows from those of the batch.

    Args:
        pushes: [n, nv] each, by step (`pushes.by_step`).
    """
    steps = commands.w.steps
    q, v = (np.empty((batch.nsim, steps + 1, x.shape[1])) for x in (batch.qpos, batch.qvel))
    q[:, 0], v[:, 0] = batch.qpos, batch.qvel
    control = commands.along() if batch.model.nu else None
    for (begin, push), end in zip(pushes.items(), [*pushes, steps][1:], strict=True):
        batch.bind("qfrc_applied")[:] = push
        some = None if control is None else control[:, begin:end]
        told = batch.rollout(end - begin, some, record=("qpos", "qvel"))
        q[:, begin + 1 : end + 1], v[:, begin + 1 : end + 1] = told["qpos"], told["qvel"]
    return _given_up(np.moveaxis(q, 0, 1), np.moveaxis(v, 0, 1))


def step_by_step(
    batch: Batch,
    runtime: Runtime,
    guide: Guide | None,
    commands: Commands,
    moved: Array,
    pushes: dict[int, Array],
) -> tuple[Array, Array]:
    """As `by_the_engine`, with effects and guided joints in each step.

    Args:
        moved: [n, nv] change of the starts' velocities.
    """
    m, w, window = batch.model, commands.w, commands.window
    qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
    ctrl = batch.bind("ctrl") if m.nu else None
    q, v = np.empty((w.steps + 1, *qpos.shape)), np.empty((w.steps + 1, *qvel.shape))
    if guide is not None:
        guide.place(0)
    if ctrl is not None:
        ctrl[:] = commands(0)
    runtime.begin(w, window, moved, commands)
    run_up(batch, m, runtime, w, window, moved, commands)
    q[0], v[0] = qpos, qvel
    for k in range(w.steps):
        if ctrl is not None:
            ctrl[:] = commands(k)
        runtime.push = pushes.get(k, runtime.push)
        runtime.apply()
        if guide is not None:
            guide.push(k)
        batch.step()
        if guide is not None:
            guide.place(k + 1)
        q[k + 1], v[k + 1] = qpos, qvel
        if not _calm(qvel):
            lost = diverged(qvel)
            qpos[lost], qvel[lost] = q[0, lost], 0.0
    return _given_up(q, v)


def states_between(m: mujoco.MjModel, q: Array, v: Array, times: Array, dt: float) -> tuple[Array, Array]:
    """States at any times [n, N] between the steps of trajectories [K + 1, n, .]."""
    k = np.clip(np.floor(times / dt + 1e-6).astype(int), 0, q.shape[0] - 2)
    s = times / dt - k
    s = np.where(np.abs(s - np.round(s)) < 1e-6, np.round(s), s)[..., None]
    rows = np.arange(q.shape[1])[:, None]
    q0, q1, v0, v1 = q[k, rows], q[k + 1, rows], v[k, rows], v[k + 1, rows]
    pv = v0 + s * (v1 - v0)
    pq = q0 + s * (q1 - q0)
    for j in range(m.njnt):
        if is_scalar(m, j):
            a, d = int(m.jnt_qposadr[j]), int(m.jnt_dofadr[j])
            pq[..., a] = hermite(s[..., 0], dt, q0[..., a], q1[..., a], v0[..., d], v1[..., d])
    return pq, pv


def _calm(v: Array) -> bool:
    """Whether nothing diverges (cheaper than `diverged`)."""
    return bool(v.max() < DIVERGED and v.min() > -DIVERGED)


def _given_up(q: Array, v: Array) -> tuple[Array, Array]:
    """What diverges is given up: from there on it rests where it began."""
    if not _calm(v):
        lost = np.logical_or.accumulate(diverged(v), axis=0)
        q[lost], v[lost] = np.broadcast_to(q[:1], q.shape)[lost], 0.0
    return q, v
