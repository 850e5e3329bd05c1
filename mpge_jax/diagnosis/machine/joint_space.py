"""Differences and sums of positions in joint space, vectorised over simulations, for every joint type."""

from __future__ import annotations

import mujoco
import numpy as np

Array = np.ndarray


def columns_of(model: mujoco.MjModel) -> tuple[Array, Array, list[tuple[int, int]]]:
    """(qpos columns, dofs) that add like numbers, and (qpos column, dof) of quaternions."""
    columns, dofs, quats = [], [], []
    for j in range(model.njnt):
        q, v, kind = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j]), model.jnt_type[j]
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            columns += [q, q + 1, q + 2]
            dofs += [v, v + 1, v + 2]
            quats.append((q + 3, v + 3))
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            quats.append((q, v))
        else:
            columns.append(q)
            dofs.append(v)
    return np.array(columns, dtype=int), np.array(dofs, dtype=int), quats


def dof_of_column(model: mujoco.MjModel) -> dict[int, int]:
    """qpos column -> dof, of all that add like numbers."""
    columns, dofs, _ = columns_of(model)
    return {int(c): int(d) for c, d in zip(columns, dofs, strict=True)}


def multiply(a: Array, b: Array) -> Array:
    """Quaternion product [..., 4]."""
    w = a[..., 0] * b[..., 0] - (a[..., 1:] * b[..., 1:]).sum(-1)
    x = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([w[..., None], x], -1)


def difference(model: mujoco.MjModel, start: Array, end: Array) -> Array:
    """Tangent vector [..., nv] that leads from `start` to `end` [..., nq] (body frame for rotations)."""
    columns, dofs, quats = columns_of(model)
    out = np.empty((*np.broadcast_shapes(start.shape, end.shape)[:-1], model.nv))
    out[..., dofs] = end[..., columns] - start[..., columns]
    for q, v in quats:
        inverse = start[..., q : q + 4] * np.array([1.0, -1.0, -1.0, -1.0])
        d = multiply(inverse, end[..., q : q + 4])
        sine = np.linalg.norm(d[..., 1:], axis=-1)
        angle = 2 * np.arctan2(sine, d[..., 0])
        angle = np.where(angle > np.pi, angle - 2 * np.pi, angle)
        factor = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)
        out[..., v : v + 3] = d[..., 1:] * factor[..., None]
    return out


def integrate(model: mujoco.MjModel, start: Array, move: Array) -> Array:
    """Position [..., nq] that lies a tangent vector [..., nv] away from `start`."""
    columns, dofs, quats = columns_of(model)
    out = start.copy()
    out[..., columns] += move[..., dofs]
    for q, v in quats:
        r = move[..., v : v + 3]
        angle = np.linalg.norm(r, axis=-1, keepdims=True)
        half = 0.5 * angle
        sinc = np.where(angle > 1e-12, np.sin(half) / np.maximum(angle, 1e-12), 0.5)
        out[..., q : q + 4] = multiply(start[..., q : q + 4], np.concatenate([np.cos(half), r * sinc], -1))
    return out
