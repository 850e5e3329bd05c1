"""Whether recordings and model together can be diagnosed at all; what the user should know of them."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.model import Names, qpos_columns
from mpge_jax.diagnosis.recording import Recording
from mpge_jax.diagnosis.states import Noise

RESTING = 10.0
"""Deviations of the noise within which a joint that does not move stays."""


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
    """Warn of what a model hides: disabled forces, and what integrators hold."""
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


def check_motion(
    recordings: list[Recording], model: mujoco.MjModel, names: Names, noise: Noise, warnings: list[str]
) -> None:
    """Warn of machines that never moved, and of joints that were never measured."""
    span = np.zeros(model.nq)
    for r in recordings:
        span = np.maximum(span, np.nan_to_num(np.ptp(r.qpos, axis=0)))
    if np.all(span <= RESTING * noise.qpos):
        warnings.append(
            "the robot never moved: friction, damping, inertia, drag, delay and lag cannot be seen; only constant "
            "forces against the held pose can."
        )
    unmeasured = np.all([np.isnan(r.qpos).all(0) for r in recordings], axis=0)
    sometimes = np.any([np.isnan(r.qpos).all(0) for r in recordings], axis=0)
    for j in range(model.njnt):
        columns = slice(*qpos_columns(model, j))
        if unmeasured[columns].any():
            part = "" if unmeasured[columns].all() else "a part of "
            warnings.append(
                f"{part}the position of joint {names.joints[j]} was never measured; it is taken to stay where the "
                "model has it."
            )
        elif sometimes[columns].any():
            warnings.append(f"the position of joint {names.joints[j]} was not measured in every recording.")
