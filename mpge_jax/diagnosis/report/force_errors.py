"""Recordings of motion and force without commands (test benches): the force is predicted from the motion.

The model is turned round: positions, velocities and accelerations come from the smoothed recording, and inverse
dynamics gives the actuator forces that the motion needs. Errors are in force units.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.drive import Drive
from mpge_jax.diagnosis.force_balance import tracks
from mpge_jax.diagnosis.force_balance.tracks import EDGE, mean_force
from mpge_jax.diagnosis.machine.model import free_inertia, moments
from mpge_jax.diagnosis.recordings.noise_level import column_noise
from mpge_jax.diagnosis.recordings.states import estimate
from mpge_jax.diagnosis.simulation import single_step
from mpge_jax.diagnosis.simulation.drive_signal import Source
from mpge_jax.diagnosis.simulation.single_step import Machine
from mpge_jax.diagnosis.verdict.result import Result

Array = np.ndarray
MAX_ROWS = 6000
"""Most rows that are predicted, over all recordings together."""
ROUNDS = 3
"""Fixed-point rounds for friction that depends on the force itself."""


@dataclass(frozen=True)
class Trace:
    """One recording: time [T] s; measured, before (nominal) and after (corrected) [T, nu] forces."""

    name: str
    time: Array
    measured: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class ForceErrors:
    """Root-mean-square errors of predicted actuator forces: over all, and [nu] by actuator (NaN unmeasured)."""

    before: float
    after: float
    floor: float
    each_before: Array
    each_after: Array
    traces: tuple[Trace, ...]


def motion_is_given(d: Result) -> bool:
    """Whether the recordings hold forces and no commands, and the force can be computed from the motion.

    A gap or a spring between motor and link hides the motor's motion, and an encoder that is off or late the link's.
    """
    hidden = any(isinstance(t.effect, Drive) or t.effect.senses for t in d.terms)
    return tracks.motion_is_given(d.prepared) and not hidden


def force_errors(d: Result, held: bool) -> ForceErrors:
    """Errors over the training or the held-out recordings."""
    p = d.prepared
    sources = p.held_sources if held else p.train_sources
    parts = d.fit.hypothesis.split(p.ctx, d.fit.theta)
    nominal, corrected = (Machine.build(p.ctx, tuple(x), tuple(x.values())) for x in ({}, parts))
    traces, spread = [], []
    most = max(MAX_ROWS // len(sources), 100)
    for i, source in enumerate(sources):
        rows = slice(EDGE, min(source.recording.time.size - EDGE, EDGE + most))
        before, after = (_needed(m, source, rows) for m in (nominal, corrected))
        again = _needed(corrected, _noisier(p, source, np.random.default_rng([d.config.seed, i])), rows)
        measured = np.where(p.measured, mean_force(source)[rows], np.nan)
        spread.append(np.where(p.measured, again - after, np.nan))
        traces.append(
            Trace(
                source.recording.name,
                source.recording.shown_origin + source.recording.time[rows],
                measured,
                before,
                after,
            )
        )
    all_rows = {k: np.concatenate([getattr(t, k) for t in traces]) for k in ("measured", "before", "after")}
    wrong = [all_rows[k] - all_rows["measured"] for k in ("before", "after")]
    each = [np.sqrt(_mean(x**2, axis=0)) for x in wrong]
    # the mean of two neighbouring intervals halves the variance of the sensor's noise
    floor = np.sqrt(_mean(np.concatenate(spread) ** 2) + 0.5 * _mean(_sensor_noise(p) ** 2))
    return ForceErrors(
        float(np.sqrt(_mean(wrong[0] ** 2))), float(np.sqrt(_mean(wrong[1] ** 2))), float(floor), each[0], each[1],
        tuple(traces),
    )  # fmt: skip


def _mean(x: Array, axis: int | None = None) -> Any:
    seen = np.isfinite(x)
    count = seen.sum(axis)
    return np.where(count > 0, np.where(seen, x, 0.0).sum(axis) / np.maximum(count, 1), np.nan)


def _sensor_noise(p: Prepared) -> Array:
    """Deviation [nu] of the measured forces' noise (NaN unmeasured)."""
    recordings = [s.recording for s in p.train_sources + p.held_sources]
    out = np.full(p.model.nu, np.nan)
    for a in np.flatnonzero(p.measured):
        level, _ = column_noise([r.time for r in recordings], [r.known("force")[:, a] for r in recordings])
        out[a] = level if np.isfinite(level) else 0.0
    return out


def _noisier(p: Prepared, source: Source, rng: np.random.Generator) -> Source:
    """The recording with as much noise once more: how much the prediction moves is what noise does to it."""
    r = source.recording
    noisy = replace(r, qpos=r.qpos + p.noise.qpos * rng.standard_normal(r.qpos.shape), qvel=None)
    states = estimate([noisy], p.model, p.names)[1][0]
    return replace(source, states=states)


def _needed(machine: Machine, source: Source, rows: slice) -> Array:
    """Actuator forces [T, nu], before the gear, that the motion needs."""
    model = copy.copy(machine.model)
    data, states, time = mujoco.MjData(model), source.states, source.recording.time
    memory: tuple[Any, ...] | None = None
    out, force = [], np.zeros(model.nu)
    for row in range(rows.start, rows.stop):
        data.qpos[:], data.qvel[:], data.qacc[:] = states.qpos[row], states.qvel[row], states.qacc[row]
        dt = float(time[row] - time[row - 1])
        if not machine.runtime:
            mujoco.mj_inverse(model, data)
            force = _by_actuator(model, data, data.qfrc_inverse)
        # friction that depends on the force: the last row's force is a good guess
        for _ in range(ROUNDS if machine.runtime else 0):
            mujoco.mj_inverse(model, data)
            step = single_step.observe(
                np, machine, data.qpos, data.qvel, force, _velocities(model, data), force, dt, data.qfrc_bias,
                partial(free_inertia, model, data.qLD),
            )  # fmt: skip
            start = single_step.force_start(np, machine, step) if memory is None else memory
            applied, kept = single_step.force_step(np, machine, step, start)
            model.dof_frictionloss[:] = applied.dry
            mujoco.mj_inverse(model, data)
            pushed = applied.qfrc + _joint_space(model, data, applied.xfrc)
            force = _by_actuator(model, data, data.qfrc_inverse - pushed)
        if machine.runtime:
            memory = kept
        out.append(force)
    return np.array(out).reshape(-1, model.nu)


def _by_actuator(model: mujoco.MjModel, data: mujoco.MjData, needed: Array) -> Array:
    """Forces [nu] whose moments make up generalised forces [nv], as nearly as the actuators can."""
    mujoco.mj_transmission(model, data)
    moment = moments(model, data)
    driven = np.abs(moment).max(axis=0, initial=0.0) > 0
    return np.linalg.lstsq(moment[:, driven].T, needed[driven], rcond=None)[0]


def _velocities(model: mujoco.MjModel, data: mujoco.MjData) -> Callable[[int], Array]:
    """World velocity [3] of a body's centre of mass."""

    def velocity(body: int) -> Array:
        out = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, out, 0)
        return out[3:]

    return velocity


def _joint_space(model: mujoco.MjModel, data: mujoco.MjData, xfrc: Array) -> Array:
    """Generalised forces [nv] of forces [nbody, 6] at the bodies' centres of mass."""
    out = np.zeros(model.nv)
    for body in np.flatnonzero(np.any(xfrc, axis=1)):
        mujoco.mj_applyFT(model, data, xfrc[body, :3], xfrc[body, 3:], data.xipos[body], int(body), out)
    return out
