"""Whether recordings and model together can be diagnosed at all; what the user should know of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.couplings import led
from mpge_jax.diagnosis.machine.model import (
    Names,
    actuators_of_joint,
    floating_base_joints,
    qpos_columns,
    weighed_by_torque,
)
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.states import States

RESTING, STILL = 2.0, 2e-3
"""Standard deviation of a position, over that of its noise and in rad or m, below which it does not move: noise alone
is no measure, as fast motion between rows passes for it."""
TURNS, BEYOND = 4 * np.pi, 10.0
"""Angle (rad) from which on the unit of positions is doubted, and how many times what drives it a joint would have to
need for the unit to be wrong (57 times in degrees)."""
POSES_OF_GRAVITY = 50
LISTED = 3
"""Recordings that a warning names, at most."""
POSES, MOVED, MATTERS = 5, (-1.0, -0.3, -0.1, 0.1, 0.3), 0.02
"""Poses in which a base is moved by so much (m or rad), and the share of the accelerations that must change for its
pose to matter."""


def told_once(recordings: list[Recording]) -> list[str]:
    """Warnings of all recordings; what is the same for several of them is said once."""
    groups: dict[str, list[str]] = {}
    for r in recordings:
        for warning in r.warnings:
            text = warning.removeprefix(f"{r.name}: ")
            groups.setdefault(text, []).extend([] if text == warning else [r.name])
    return [f"{_listed(called, len(recordings))}{text}" for text, called in groups.items()]


def _listed(called: list[str], count: int) -> str:
    """Names of recordings before what is said of them; nothing where none is meant."""
    if len(called) == count > 1:
        return "every recording: "
    more = f" and {len(called) - LISTED} others" if len(called) > LISTED else ""
    return f"{', '.join(called[:LISTED])}{more}: " if called else ""


def check_commands(recordings: list[Recording], measured: np.ndarray, names: Names) -> None:
    """Raises InputError where neither commands nor forces drive a machine; measured: [nu] in every recording."""
    for r in recordings:
        if r.ctrl is None and not measured.all():
            name = names.actuators[int(np.flatnonzero(~measured)[0])]
            raise InputError(
                f"{r.name} holds no commands, and the force of {name} was not measured in most rows of "
                "every recording; add 'ctrl' or leave the recording out."
            )


def check_forces(
    recordings: list[Recording], measured: np.ndarray, names: Names, warnings: list[str]
) -> None:
    """Warn of forces that some recordings hold and others lack: they are not used."""
    some = [np.isfinite(r.known("force")).any(0) for r in recordings if r.force is not None]
    for a in np.flatnonzero(np.any(some, axis=0) & ~measured if some else []):
        warnings.append(
            f"the force of {names.actuators[a]} was not measured in most rows of every recording, and is not used."
        )


def check_copies(train: list[Recording], held: list[Recording], warnings: list[str]) -> None:
    """Warn of held-out recordings that are also trained on."""
    for h in held:
        for r in train:
            if np.array_equal(h.time, r.time) and np.array_equal(h.qpos, r.qpos, equal_nan=True):
                warnings.append(
                    f"{h.name} is held out, but {r.name} is the same recording: it proves nothing."
                )


def check_model(model: mujoco.MjModel, names: Names, warnings: list[str]) -> None:
    """Warn of what a model lacks or hides: actuators, disabled forces, and what integrators hold."""
    if model.nu == 0:
        warnings.append(
            "the model has no actuators, so that the machine is taken to move by itself: whatever drove it counts as "
            "physics that is missing."
        )
    for flag, word in (
        (mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS, "frictionloss"),
        (mujoco.mjtDisableBit.mjDSBL_DAMPER, "damper"),
        (mujoco.mjtDisableBit.mjDSBL_SPRING, "spring"),
    ):
        if model.opt.disableflags & flag:
            warnings.append(
                f"the model disables {word}: effects of that kind do nothing in it and are not found."
            )
    for a in np.flatnonzero(model.actuator_dyntype == mujoco.mjtDyn.mjDYN_INTEGRATOR):
        warnings.append(
            f"{names.actuators[a]} integrates its commands; what it held when a recording began is taken for zero."
        )


def check_base(recordings: list[Recording], model: mujoco.MjModel, names: Names) -> None:
    """Raises InputError where the pose of a floating base was never measured and decides how the joints move.

    Whether it touches the ground and which way gravity pulls does; how far it went along a plane does not.
    """
    missing = np.all([np.isnan(r.qpos).all(0) for r in recordings], axis=0)
    dofs = [d for j in floating_base_joints(model) for d in unmeasured_dofs(model, j, missing)]
    measured = [d for d in range(model.nv) if not unmeasured_dofs(model, int(model.dof_jntid[d]), missing)]
    if not dofs or not measured:
        return
    data, poses = mujoco.MjData(model), [r.qpos[len(r.qpos) // 2] for r in recordings[:POSES]]

    def accelerations(pose: np.ndarray, move: np.ndarray) -> np.ndarray:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = np.where(np.isnan(pose), model.qpos0, pose)
        mujoco.mj_integratePos(model, data.qpos, move, 1.0)
        mujoco.mj_forward(model, data)
        return data.qacc[measured].copy()

    plain = [accelerations(pose, np.zeros(model.nv)) for pose in poses]
    for d in dofs:
        moves = [size * np.eye(model.nv)[d] for size in MOVED]
        change = max(
            np.abs(accelerations(pose, move) - a).max()
            for pose, a in zip(poses, plain, strict=True)
            for move in moves
        )
        if change > MATTERS * max(np.abs(plain).max(), 1e-6):
            name = names.joint_of_dof(model, d)
            raise InputError(
                f"how the machine moves depends on the pose of its base ('{name}'), which was never measured; record "
                "it, or fix the base in the model if it stands still."
            )


def unmeasured_dofs(model: mujoco.MjModel, joint: int, missing: np.ndarray) -> list[int]:
    """Degrees of freedom of a joint of which some column [nq] is missing."""
    first, end = qpos_columns(model, joint)
    columns, dof = np.flatnonzero(missing[first:end]), int(model.jnt_dofadr[joint])
    kind = model.jnt_type[joint]
    if kind == mujoco.mjtJoint.mjJNT_FREE:
        turned = [dof + 3, dof + 4, dof + 5] if (columns >= 3).any() else []
        return [dof + int(c) for c in columns if c < 3] + turned
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        return [dof, dof + 1, dof + 2] if columns.size else []
    return [dof] if columns.size else []


def check_units(
    recordings: list[Recording],
    states: list[States],
    model: mujoco.MjModel,
    names: Names,
    forces: list[np.ndarray],
) -> None:
    """Raises InputError where positions of a hinge cannot be radians (`not_radians`)."""
    for j, why in not_radians(recordings, lambda: states, model, names, forces):
        raise InputError(
            f"{why}. Give radians, or a map with 'qpos:{names.joints[j]}: {{from: ..., unit: deg}}' (ticks: scale: "
            "2 pi over the ticks of a turn)."
        )


def not_radians(
    recordings: list[Recording],
    states: Callable[[], list[States]],
    model: mujoco.MjModel,
    names: Names,
    forces: list[np.ndarray],
) -> Iterator[tuple[int, str]]:
    """Hinges of which positions cannot be radians, and why: they turn far, and their inertia alone would need far more
    torque than their drives and gravity give.

    Args:
        states: asked for where a joint turns far. forces: [T, nu] of actuators that pass on their command or a measured
            force.
    """
    for j in range(model.njnt):
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE:
            continue
        q, dof = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])
        far = max(float(np.nanmax(np.abs(r.qpos[:, q]), initial=0.0)) for r in recordings)
        own = actuators_of_joint(model, j)
        if far <= TURNS or not weighed_by_torque(model, j):
            continue
        gains = model.actuator_gear[own, 0] * model.actuator_gainprm[own, 0]
        driven = _rms([f[:, own] @ gains for f in forces])
        needed = float(model.dof_M0[dof]) * _rms([x.qacc[:, dof] for x in states()])
        given = driven + _rms([_weight(model, x)[:, dof] for x in states()])
        if needed > BEYOND * given:
            yield (
                j,
                f"positions of {names.joints[j]} reach {far:.4g}, and cannot be radians: to turn like that it would "
                f"need {needed:.2g} N m, where drive and gravity give {given:.2g}",
            )


def _rms(parts: list[np.ndarray]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate(parts) ** 2)))


def _weight(model: mujoco.MjModel, states: States) -> np.ndarray:
    """Generalised forces [R, nv] of gravity at some rows."""
    data, out = mujoco.MjData(model), []
    for q in states.qpos[:: max(1, len(states.qpos) // POSES_OF_GRAVITY)]:
        data.qpos[:], data.qvel[:] = q, 0.0
        mujoco.mj_forward(model, data)
        out.append(data.qfrc_bias.copy())
    return np.array(out)


def check_motion(
    recordings: list[Recording], model: mujoco.MjModel, names: Names, noise: Noise, warnings: list[str]
) -> None:
    """Warn of joints that were never measured.

    Raises:
        InputError: the machine never moved.
    """
    spread = np.max([np.nan_to_num(np.std(r.qpos, axis=0)) for r in recordings], axis=0)
    if np.all(spread <= np.minimum(RESTING * noise.qpos, STILL)):
        raise InputError(
            "the robot never moved in any recording: nothing of its dynamics can be seen; record every joint in motion."
        )
    missing = [np.isnan(r.qpos).all(0) for r in recordings]
    unmeasured, sometimes = np.all(missing, axis=0), np.any(missing, axis=0)
    by = {x.joint: x.by for x in led(model, unmeasured)}
    for j in range(model.njnt):
        columns = slice(*qpos_columns(model, j))
        if j in by:
            warnings.append(
                f"the position of joint {names.joints[j]} was never measured; it is taken to follow "
                f"{names.joints[by[j]]}, as an equality of the model says."
            )
        elif unmeasured[columns].any():
            part = "" if unmeasured[columns].all() else "a part of "
            warnings.append(
                f"{part}the position of joint {names.joints[j]} was never measured; it is taken to stay where the "
                "model has it."
            )
        elif sometimes[columns].any():
            warnings.append(f"the position of joint {names.joints[j]} was not measured in every recording.")
