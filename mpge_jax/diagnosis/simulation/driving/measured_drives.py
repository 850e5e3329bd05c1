"""What drives do as the model has it, and machines that are driven by the forces measured on them."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import clipped, has_plain_law, is_joint_transmission
from mpge_jax.diagnosis.recordings.recording import Recording


def measured_forces(recordings: list[Recording], model: mujoco.MjModel) -> np.ndarray:
    """[nu] whether each actuator's force was measured in every recording."""
    if not recordings or any(r.force is None for r in recordings):
        return np.zeros(model.nu, bool)
    return np.all([np.isfinite(r.known("force")).mean(0) > 0.5 for r in recordings], axis=0)


def drive_by_force(spec: mujoco.MjSpec, measured: np.ndarray) -> mujoco.MjSpec:
    """A copy in which actuators with measured forces pass on their command as force, and none has a delay: windows
    would begin with its buffer empty, so that `Source` delays the commands instead."""
    spec = spec.copy()
    # they may hold activations of drives that have none any more
    for key in list(spec.keys):
        spec.delete(key)
    for actuator in spec.actuators:
        actuator.delay, actuator.nsample = 0.0, 0
        if not measured[actuator.id]:
            continue
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_NONE
        actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
        actuator.gainprm = [1.0, *([0.0] * (len(actuator.gainprm) - 1))]
        actuator.biasprm = [0.0] * len(actuator.biasprm)
        actuator.ctrllimited = actuator.forcelimited = actuator.actlimited = 0
        actuator.actrange, actuator.actearly = [0.0, 0.0], False
    return spec


def driving(r: Recording, plain: mujoco.MjModel, measured: np.ndarray) -> np.ndarray:
    """[T, nu] commands within their limits, or forces where they were measured."""
    command = np.zeros((r.time.size, plain.nu)) if r.ctrl is None else clipped(plain, r.ctrl)
    for a in np.flatnonzero(measured):
        force = r.known("force")[:, a]
        good = np.isfinite(force)
        command[:, a] = np.interp(r.time, r.time[good], force[good])
    return command


def follows(model: mujoco.MjModel) -> np.ndarray:
    """[nu] whether an actuator's force follows the motion between two rows (a servo, a filter); a plain motor's is
    held like its command."""
    moving = model.actuator_biastype != mujoco.mjtBias.mjBIAS_NONE
    moving |= model.actuator_gaintype != mujoco.mjtGain.mjGAIN_FIXED
    return moving | (model.actuator_dyntype != mujoco.mjtDyn.mjDYN_NONE)


def is_servo(plain: mujoco.MjModel, a: int) -> bool:
    """Whether an actuator drives its joint to a position or a speed, by a plain law."""
    return bool(plain.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE and has_plain_law(plain, a))


def plain_force(
    plain: mujoco.MjModel, a: int, ctrl: np.ndarray, qpos: np.ndarray, qvel: np.ndarray
) -> np.ndarray:
    """Force [T] that the model expects of actuator `a` (see `has_plain_law`) under commands [T, nu] along a
    motion [T, nq], [T, nv]."""
    force = plain.actuator_gainprm[a, 0] * clipped(plain, ctrl)[:, a]
    if plain.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE:
        constant, stiffness, damping = plain.actuator_biasprm[a, :3]
        length, speed = stroke(plain, a, qpos, qvel)
        force = force + constant + stiffness * length + damping * speed
    limited = plain.actuator_forcelimited[a]
    return np.clip(force, *plain.actuator_forcerange[a]) if limited else force


def stroke(
    model: mujoco.MjModel, a: int, qpos: np.ndarray, qvel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Length and speed [T] of an actuator on one joint, with its gear; zeros of others."""
    if not is_joint_transmission(model, a):
        return np.zeros(len(qpos)), np.zeros(len(qpos))
    joint, gear = int(model.actuator_trnid[a, 0]), float(model.actuator_gear[a, 0])
    return (
        gear * qpos[:, model.jnt_qposadr[joint]],
        gear * qvel[:, model.jnt_dofadr[joint]],
    )
