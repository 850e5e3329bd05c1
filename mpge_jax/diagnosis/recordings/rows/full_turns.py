"""The full turns by which the readings of angles jump where an encoder wraps."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import Names
from mpge_jax.diagnosis.recordings.recording import Recording, longest_step

WRAP = 1.6 * np.pi
"""Least jump (rad) of an angle from one row to the next that is taken for a full turn, where all others are far
smaller."""


def unwrapped(recording: Recording, model: mujoco.MjModel, names: Names) -> Recording:
    """The recording without the full turns by which the angles of unlimited hinges jump where an encoder wraps.

    Where velocities were recorded, they tell how far it went from row to row.
    """
    qpos, notes = recording.qpos.copy(), []
    for j in range(model.njnt):
        column = int(model.jnt_qposadr[j])
        value, v = qpos[:, column], np.full(recording.time.size, np.nan)
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE or model.jnt_limited[j] or np.isnan(value).any():
            continue
        if np.ptp(value) > 2.01 * np.pi:
            continue
        if recording.qvel is not None:
            v = recording.qvel[:, model.jnt_dofadr[j]]
        steps = np.diff(value)
        if np.isfinite(v).all():
            dt = np.diff(recording.time)
            turns = np.round((0.5 * (v[1:] + v[:-1]) * dt - steps) / (2 * np.pi))
            # what it did in a gap nobody knows, if it was fast
            far = np.maximum(np.abs(v[1:]), np.abs(v[:-1])) * dt > np.pi
            turns[(dt > longest_step(recording)) & far] = 0
        else:
            jumps = np.abs(steps) > WRAP
            rest = np.abs(steps[~jumps])
            turns = -np.sign(steps) * jumps
            if not rest.size or rest.max() > WRAP / 3:
                continue
        if turns.any():
            qpos[1:, column] += 2 * np.pi * np.cumsum(turns)
            notes.append(
                f"{recording.name}: the angle of {names.joints[j]} wraps at a full turn; it was made continuous."
            )
    return replace(recording, qpos=qpos, warnings=(*recording.warnings, *notes)) if notes else recording
