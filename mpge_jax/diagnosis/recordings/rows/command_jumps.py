"""Jumps of accelerations with commands that are held from row to row, and what they make of the motion.

A smoother of positions takes accelerations to change gradually. Where commands jump at the rows and these are as far
apart as what they drive takes to answer, every velocity that it tells at a row leans towards what comes next. What the
model's drives make of the commands is known beforehand: the smoother is given what that leaves.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import clipped, has_plain_law, moments
from mpge_jax.diagnosis.recordings.recording import Recording

Array = np.ndarray
FADES = 0.25
"""Rows over which the answer to a jump fades: what lasts longer, the smoother follows by itself."""


def command_jumps(r: Recording, plain: mujoco.MjModel) -> Array:
    """By how much the acceleration of each degree of freedom jumps at the rows [T, nv], as the nominal model has it."""
    out = np.zeros((r.time.size, plain.nv))
    told = [a for a in range(plain.nu) if has_plain_law(plain, a)]
    if r.ctrl is None or not told:
        return out
    command = np.nan_to_num(clipped(plain, r.ctrl)[:, told])
    jumps = np.diff(command, axis=0, prepend=command[:1]) * plain.actuator_gainprm[told, 0]
    data, qpos = mujoco.MjData(plain), np.where(np.isnan(r.qpos), plain.qpos0, r.qpos)
    for row in np.flatnonzero(jumps.any(1)):
        data.qpos[:] = qpos[row]
        mujoco.mj_fwdPosition(plain, data)
        mujoco.mj_solveM(plain, data, out[row : row + 1], jumps[row : row + 1] @ moments(plain, data)[told])
    return out


def lasting(time: Array) -> float:
    """Seconds in which the answer to a jump fades."""
    return FADES * float(np.median(np.diff(time)))


def answer(time: Array, jumps: Array) -> tuple[Array, Array, Array]:
    """What accelerations make of the motion that jump at the rows [T, ...] and fade: positions, velocities and
    accelerations (of these the mean of before and after) at the rows."""
    q, v, a = np.zeros((3, *jumps.shape))
    if time.size < 2:
        return q, v, a
    steps, now, rate = np.diff(time), np.zeros(jumps.shape[1:]), 1.0 / lasting(time)
    for row, jump in enumerate(jumps):
        a[row], now = now + 0.5 * jump, now + jump
        if row < steps.size:
            h, left = steps[row], np.exp(-rate * steps[row])
            v[row + 1] = v[row] + now * (1.0 - left) / rate
            q[row + 1] = q[row] + v[row] * h + now * (h - (1.0 - left) / rate) / rate
            now = now * left
    return q, v, a
