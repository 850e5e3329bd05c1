"""Joint-space states of every recording: smoothed positions, velocities, accelerations and covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.couplings import led
from mpge_jax.diagnosis.machine.joint_space import dof_of_column
from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.kalman_smoother import Series, smooth
from mpge_jax.diagnosis.recordings.measurement_noise import SIGMA_FLOOR, Noise, noise_of
from mpge_jax.diagnosis.recordings.noise_level import held_error
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.rows.command_jumps import answer, command_jumps, lasting

Array = np.ndarray
UNKNOWN_VELOCITY = 1.0
"""Deviation (m/s or rad/s) of a velocity of which nothing was measured."""
LIKELIER, SHOWN = 3.0, 1.0
"""Logarithm of the odds from which on jumps with commands are heeded, and by how many deviations of a velocity they
must move it to be asked about."""
STEPS = 2
"""Timesteps of the model that answers to jumps must last at least where simulations start from the states."""
MAX_ROWS = 60_000
"""Most rows smoothed over all recordings; longer logs are read in stretches."""


@dataclass(frozen=True)
class States:
    """Estimates along one recording.

    Attributes:
        qpos: [T, nq]. qvel: [T, nv]. qacc: [T, nv].
        cov: [T, nv, 2, 2] covariance of (position, velocity) per degree of freedom.
        jumps: [T, nv] of accelerations with commands that these were told with, None: without any.
    """

    qpos: Array
    qvel: Array
    qacc: Array
    cov: Array
    jumps: Array | None = None

    def jumps_in(self, rows: slice) -> Array | None:
        """`jumps` of some rows."""
        return None if self.jumps is None else self.jumps[rows]


def estimate(
    recordings: list[Recording], model: mujoco.MjModel, names: Names
) -> tuple[Noise, list[States], list[str]]:
    """Noise levels and smoothed states. Returns warnings too."""
    noise, warnings = noise_of(recordings, model, names)
    return noise, smoothed(recordings, model, noise), warnings


def smoothed(
    recordings: list[Recording],
    model: mujoco.MjModel,
    noise: Noise,
    jumps: Sequence[Array | None] | None = None,
) -> list[States]:
    """States along recordings whose noise is known, with the `command_jumps` [T, nv] of each, if any."""
    return _smoothed(recordings, model, noise, jumps)[0]


def told_with_commands(
    recordings: list[Recording],
    model: mujoco.MjModel,
    noise: Noise,
    plain: mujoco.MjModel,
    looked_at: int,
    simulated: bool = True,
) -> list[States]:
    """`smoothed` with the `command_jumps` of the recordings, at those degrees of freedom where they make the positions
    of the first `looked_at` recordings likelier: a machine may do otherwise than its model, or at other rows.

    Args:
        plain: the nominal model. simulated: whether simulations start from these states: in their steps velocities are
            of half a step before, which is more than jumps do that last for few of them.
    """
    (without, likelihood), out = _smoothed(recordings, model, noise), []
    least = STEPS * float(model.opt.timestep) if simulated else 0.0
    slow = [r.time.size > 1 and lasting(r.time) >= least for r in recordings]
    if not any(slow):
        return without
    jumps = [command_jumps(r, plain) for r in recordings]
    each = zip(slow, recordings, without, jumps, strict=True)
    if not any(_shows(r, states, x) for its, r, states, x in each if its):
        return without
    those, reached = _smoothed(recordings, model, noise, jumps)
    heeded = (reached - likelihood)[:looked_at].sum(0) > LIKELIER
    columns = [column for column, dof in dof_of_column(model).items() if heeded[dof]]
    for r, states, its, known in zip(recordings, without, those, jumps, strict=True):
        states.qpos[:, columns] = its.qpos[:, columns]
        for to, of in ((states.qvel, its.qvel), (states.qacc, its.qacc), (states.cov, its.cov)):
            to[:, heeded] = of[:, heeded]
        follow_equalities(r, states, model)
        out.append(replace(states, jumps=np.where(heeded, known, 0.0)))
    return out if heeded.any() else without


def _shows(r: Recording, states: States, jumps: Array) -> bool:
    """Whether jumps move any velocity by what is unknown of it."""
    moved = lasting(r.time) * np.sqrt((jumps**2).mean(0))
    return bool((moved > SHOWN * np.sqrt(states.cov[:, :, 1, 1].mean(0))).any())


def _smoothed(
    recordings: list[Recording],
    model: mujoco.MjModel,
    noise: Noise,
    jumps: Sequence[Array | None] | None = None,
) -> tuple[list[States], Array]:
    """States, and the logarithms of the likelihoods of what was measured [recordings, nv]."""
    dofs, given = dof_of_column(model), jumps or [None] * len(recordings)
    likelihood = np.zeros((len(recordings), model.nv))
    answers: list[tuple[Array, Array, Array]] = []
    series: list[Series] = []
    owner: list[tuple[int, int, int]] = []
    states = []
    for i, r in enumerate(recordings):
        rows = r.time.size
        measured_v = r.qvel if r.qvel is not None else np.full((rows, model.nv), np.nan)
        cov = np.zeros((rows, model.nv, 2, 2))
        cov[:, :, 0, 0] = SIGMA_FLOOR**2
        cov[:, :, 1, 1] = np.where(np.isnan(measured_v), UNKNOWN_VELOCITY, np.minimum(noise.qvel, 1.0)) ** 2
        qpos = np.where(np.isnan(r.qpos), model.qpos0, r.qpos)
        states.append(States(qpos, np.nan_to_num(measured_v), np.zeros((rows, model.nv)), cov, given[i]))
        known = given[i]
        answers.append(answer(r.time, np.zeros((rows, model.nv)) if known is None else known))
        known_q, known_v, _ = answers[i]
        for column, dof in dofs.items():
            if np.isnan(r.qpos[:, column]).all():
                continue
            level = float(noise.qpos[column])
            held = held_error(r.qpos[:, column], float(noise.quantum[column]), level)
            usable = np.isfinite(noise.qvel[dof]) and not np.isnan(measured_v[:, dof]).all()
            if rows < 4:
                cov[:, dof, 0, 0] = noise.qpos[column] ** 2
                if usable:
                    states[i].qacc[:, dof] = np.gradient(measured_v[:, dof], r.time)
                else:
                    states[i].qvel[:, dof] = np.gradient(r.qpos[:, column], r.time)
                continue
            series.append(
                Series(
                    r.time,
                    r.qpos[:, column] - known_q[:, dof],
                    measured_v[:, dof] - known_v[:, dof] if usable else None,
                    np.sqrt(level**2 + held**2 + (noise.stamp * _speed(r.time, r.qpos[:, column])) ** 2),
                    float(noise.qvel[dof]) if usable else 1.0,
                )
            )
            owner.append((i, column, dof))
    if series:
        for (i, column, dof), estimate_ in zip(owner, smooth(series), strict=True):
            told = (x + its[:, dof] for x, its in zip(estimate_.mean.T, answers[i], strict=True))
            states[i].qpos[:, column], states[i].qvel[:, dof], states[i].qacc[:, dof] = told
            states[i].cov[:, dof] = estimate_.cov[:, :2, :2]
            likelihood[i, dof] = estimate_.likelihood
    for r, s in zip(recordings, states, strict=True):
        _rotations(r, s, model, noise)
        follow_equalities(r, s, model)
    return states, likelihood


def follow_equalities(recording: Recording, states: States, model: mujoco.MjModel) -> None:
    """Set joints that were not measured to what equalities tell of them from others."""
    for x in led(model, np.isnan(recording.qpos).all(0)):
        column, dof, by = model.jnt_qposadr[x.joint], model.jnt_dofadr[x.joint], model.jnt_dofadr[x.by]
        told = x.along(model, states.qpos, states.qvel, states.qacc)
        states.qpos[:, column], states.qvel[:, dof], states.qacc[:, dof], slope = told
        states.cov[:, dof] = slope[:, None, None] ** 2 * states.cov[:, by]


def _speed(time: Array, value: Array) -> Array:
    """[T] about how fast a noisy column moves at its rows: between the second row before and the second one after."""
    ahead = np.minimum(np.arange(time.size) + 2, time.size - 1)
    behind = np.maximum(np.arange(time.size) - 2, 0)
    return np.nan_to_num((value[ahead] - value[behind]) / (time[ahead] - time[behind]))


def _rotations(recording: Recording, states: States, model: mujoco.MjModel, noise: Noise) -> None:
    """Orientations and angular velocities (in the body's frame) of ball and free joints, with those that were measured
    taken for independent of the orientations."""
    for j in range(model.njnt):
        kind, q, v = int(model.jnt_type[j]), int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            q, v = q + 3, v + 3
        elif kind != mujoco.mjtJoint.mjJNT_BALL:
            continue
        quat = recording.qpos[:, q : q + 4]
        if np.isnan(quat).all():
            continue
        states.cov[:, v : v + 3, 0, 0] = noise.angle(q) ** 2
        measured = recording.qvel is not None and bool(np.isfinite(recording.qvel[:, v : v + 3]).all())
        known = measured and bool(np.isfinite(noise.qvel[v : v + 3]).all())
        if known:
            states.cov[:, v : v + 3, 1, 1] = noise.qvel[v : v + 3] ** 2
        if recording.time.size < 4:
            continue
        mean, omega, variance = _turning(recording.time, quat, noise.qpos[q : q + 4])
        weight = np.zeros_like(omega)
        if known:
            weight = variance / (variance + noise.qvel[v : v + 3] ** 2)
            variance = weight * noise.qvel[v : v + 3] ** 2
            omega = omega + weight * (recording.known("qvel")[:, v : v + 3] - omega)
        states.qpos[:, q : q + 4] = mean
        states.qvel[:, v : v + 3] = omega
        states.cov[:, v : v + 3, 1, 1] = variance


def _turning(time: Array, quat: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Smoothed orientations [T, 4], angular velocities in the body's frame [T, 3], and the variance of those [T, 1]."""
    parts = smooth([Series(time, quat[:, k], None, np.full(time.size, sigma[k]), 1.0) for k in range(4)])
    mean = np.stack([p.mean[:, 0] for p in parts], 1)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    rate = np.stack([p.mean[:, 1] for p in parts], 1)
    w, x = mean[:, :1], mean[:, 1:]
    dw, dx = rate[:, :1], rate[:, 1:]
    # omega = 2 * vector part of conj(quat) * dquat/dt
    omega = 2 * (w * dx - dw * x - np.cross(x, dx))
    return mean, omega, 4 / 3 * np.sum([p.cov[:, 1, 1] for p in parts], axis=0)[:, None]
