"""Typical sizes of a machine's motion and forces, and the force that the nominal model lacks, from recordings."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import Context, Samples, nominal_context
from mpge_jax.diagnosis.machine.constraints import free_of_constraints, without_loops
from mpge_jax.diagnosis.machine.contact_pairs import touching_pairs
from mpge_jax.diagnosis.machine.model import Names, is_scalar, moments
from mpge_jax.diagnosis.simulation.driving.actuator_state import activations
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source

Array = np.ndarray
MAX_SAMPLES = 1500
LEAST_DRIVE = 0.05
"""Share of what the motion needs at a joint that its actuator gives at least, for the scale of its effects: commands
may be zero throughout."""


def inverse_samples(
    model: mujoco.MjModel, sources: tuple[Source, ...], limit: int = MAX_SAMPLES
) -> tuple[Samples, Array, Array, Array, Array]:
    """Generalised forces along the smoothed motion at evenly spread rows.

    Returns:
        samples; needed [S, nv] force that the motion needs; actuator forces [S, nu]; accelerations [S, nv];
        speeds [S, nbody] of the bodies' centres of mass.
    """
    data, apart = mujoco.MjData(model), without_loops(model)
    total = sum(max(s.recording.time.size - 2, 0) for s in sources)
    stride = max(1, total // limit)
    q, v, a, residual, share, needed, drive, moving, arm = [], [], [], [], [], [], [], [], []
    for s in sources:
        # a transition has no inner row
        held = activations(model, s)
        inner = range(1, s.recording.time.size - 1, stride) if s.recording.time.size > 2 else range(1)
        for row in inner:
            data.qpos[:], data.qvel[:] = s.states.qpos[row], s.states.qvel[row]
            data.qacc[:] = s.states.qacc[row]
            data.ctrl[:] = 0.5 * (s.command[row] + s.command[max(row - 1, 0)])
            if model.na:
                data.act[:] = held[row]
            mujoco.mj_fwdPosition(model, data)
            free = free_of_constraints(model, data)
            # noise in how far a loop seems open would make forces that nothing makes
            mujoco.mj_inverse(apart, data)
            mujoco.mj_fwdActuation(model, data)
            q.append(data.qpos.copy())
            v.append(data.qvel.copy())
            a.append(data.qacc.copy())
            needed.append(data.qfrc_inverse.copy())
            drive.append(data.actuator_force.copy())
            residual.append(free @ (data.qfrc_inverse - data.qfrc_actuator))
            share.append(np.diag(free))
            moving.append(data.cvel.copy())
            arm.append(data.xipos - data.subtree_com[model.body_rootid])
    spatial = np.array(moving).reshape(len(moving), model.nbody, 6)
    arms = np.array(arm).reshape(len(arm), model.nbody, 3)
    samples = Samples(
        np.array(q).reshape(len(q), model.nq),
        np.array(v).reshape(len(v), model.nv),
        np.array(residual).reshape(len(residual), model.nv),
        np.array(share).reshape(len(share), model.nv),
    )
    return (
        samples,
        np.array(needed).reshape(len(needed), model.nv),
        np.array(drive).reshape(len(drive), model.nu),
        np.array(a).reshape(len(a), model.nv),
        np.linalg.norm(spatial[..., 3:] + np.cross(spatial[..., :3], arms), axis=-1),
    )


def _rms(x: Array, floor: float) -> Array:
    """Root mean square [c] over rows without the wildest twentieth (impacts)."""
    if not len(x):
        return np.full(x.shape[1], floor)
    cap = np.quantile(np.abs(x), 0.95, axis=0)
    return np.maximum(np.sqrt((np.minimum(np.abs(x), cap) ** 2).mean(0)), floor)


def _moments(model: mujoco.MjModel) -> Array:
    """Moments [nu, nv] of the actuators in the model's own pose."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return moments(model, data)


def _reach(model: mujoco.MjModel, torque: Array) -> Array:
    """Force [nu] by which each actuator alone would best give what the motion needs (`torque` [nv])."""
    arms = np.abs(_moments(model))
    return arms @ torque / np.maximum((arms**2).sum(1), 1e-18)


def build_context(model: mujoco.MjModel, names: Names, sources: tuple[Source, ...]) -> Context:
    """Scales of forces, speeds and ranges for this model and these recordings."""
    base = nominal_context(model)
    samples, needed, drive, acceleration, body_speed = inverse_samples(model, sources)
    weight = float(np.linalg.norm(model.opt.gravity)) * base.mass
    scale = _rms(needed, 1e-6)
    if len(drive):
        typical = _rms(drive, 0.0)
        for a, moment in enumerate(_moments(model)):
            scale = np.maximum(scale, 0.5 * np.abs(moment) * float(typical[a]))
    travel = np.ptp(samples.q, axis=0) if len(samples.q) else np.ones(model.nq)
    travel_dof = np.ones(model.nv)
    for j in range(model.njnt):
        if is_scalar(model, j):
            travel_dof[model.jnt_dofadr[j]] = travel[model.jnt_qposadr[j]]
    largest = np.quantile(np.abs(drive), 0.98, axis=0) if len(drive) else np.ones(model.nu)
    largest = np.maximum(largest, LEAST_DRIVE * _reach(model, scale))
    steps = np.concatenate([np.diff(s.recording.time) for s in sources])
    floor = 1e-3 * float(scale.max())
    # where a column was never measured, nobody knows what touched
    known = len(samples.q) and not any(np.isnan(s.recording.qpos).all(0).any() for s in sources)
    return Context(
        model=model,
        names=names,
        torque=np.maximum(scale, max(floor, 1e-6)),
        speed=_rms(samples.v, 1e-4),
        body_speed=_rms(body_speed, 1e-4),
        travel=np.maximum(travel_dof, 1e-4),
        acceleration=_rms(acceleration, 1e-3),
        drive=np.maximum(largest, max(1e-3 * float(np.max(largest, initial=0.0)), 1e-6)),
        length=base.length,
        mass=base.mass,
        period=float(np.median(steps)),
        timestep=base.timestep,
        contacts=touching_pairs(model, samples.q, base.length) if known else base.contacts,
        weight=max(
            weight, float(base.mass * np.median(np.abs(acceleration))) if len(acceleration) else 1.0, 1e-3
        ),
        samples=samples,
    )
