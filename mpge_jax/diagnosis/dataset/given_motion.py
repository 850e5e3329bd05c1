"""Whether the motion is given and forces are to be predicted."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import is_scalar
from mpge_jax.diagnosis.recordings.recording import Recording

EDGE = 5
"""Rows at either end of a recording, where its acceleration is known badly."""


def motion_is_given(recordings: list[Recording], model: mujoco.MjModel, measured: np.ndarray) -> bool:
    """Whether the recordings hold forces and no commands, and the force can be computed from the motion: every joint's
    acceleration is known (angular ones of ball and free joints are not estimated).

    Args:
        measured: [nu] whether an actuator's force was measured.
    """
    if not measured.any() or any(r.ctrl is not None for r in recordings):
        return False
    return all(accelerations_are_known(r, model) for r in recordings)


def accelerations_are_known(r: Recording, model: mujoco.MjModel) -> bool:
    """Whether a recording holds rows away from its ends, all positions, and no joint that turns freely."""
    whole = r.time.size > r.first_shown + 2 * EDGE and not np.isnan(r.qpos).any()
    return bool(whole and all(is_scalar(model, j) for j in range(model.njnt)))
