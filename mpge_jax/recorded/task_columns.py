"""Recordings of a machine in the order of a task's own model: joints and actuators by name."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import Names, names_of
from mpge_jax.diagnosis.recordings.recording import Recording


def in_order_of(
    own: mujoco.MjModel, recordings: list[Recording], read_by: mujoco.MjModel, names: Names
) -> list[Recording]:
    """Recordings with the columns of the task's own model.

    Args:
        own: the task's. read_by: the model that the recordings were read with. names: of the latter.

    Raises:
        InputError: a joint or an actuator of the task is not in that model, or of another kind there.
    """
    wanted = names_of(own)
    qpos, qvel = [], []
    for j, joint in enumerate(wanted.joints):
        k = _place(joint, names.joints, "joint")
        if own.jnt_type[j] != read_by.jnt_type[k]:
            raise InputError(
                f"the joint {joint} of the task is of another kind in the model given by --model."
            )
        width = [len(_columns(own.jnt_qposadr, own.nq, j)), len(_columns(own.jnt_dofadr, own.nv, j))]
        qpos += list(_columns(read_by.jnt_qposadr, read_by.nq, k))[: width[0]]
        qvel += list(_columns(read_by.jnt_dofadr, read_by.nv, k))[: width[1]]
    ctrl = [_place(a, names.actuators, "actuator") for a in wanted.actuators]
    return [
        replace(
            r,
            qpos=r.qpos[:, qpos],
            qvel=None if r.qvel is None else r.qvel[:, qvel],
            ctrl=None if r.ctrl is None else r.ctrl[:, ctrl],
            force=None,
        )
        for r in recordings
    ]


def _columns(starts: np.ndarray, total: int, j: int) -> range:
    ends = np.append(starts, total)
    return range(int(ends[j]), int(ends[j + 1]))


def _place(name: str, known: tuple[str, ...], kind: str) -> int:
    if name not in known:
        raise InputError(
            f"the {kind} {name} of the task is not in the model given by --model (it has {', '.join(known)[:200]})."
        )
    return known.index(name)
