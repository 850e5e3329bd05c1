"""Rigid bodies: rotations, and a mass added to one."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.step import Array


def rotation_of(quat: Array, xp: Any) -> Array:
    """Rotation matrices [..., 3, 3] of unit quaternions [..., 4] (w, x, y, z)."""
    w, x, y, z = (quat[..., i] for i in range(4))
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return xp.stack(rows, -1).reshape(*quat.shape[:-1], 3, 3)


def quaternion_of(r: Array, xp: Any) -> Array:
    """Unit quaternions [..., 4] of rotation matrices: the leading eigenvector of Bar-Itzhack's matrix."""
    t = r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2]
    a, b, c = (
        r[..., 2, 1] - r[..., 1, 2],
        r[..., 0, 2] - r[..., 2, 0],
        r[..., 1, 0] - r[..., 0, 1],
    )
    s01, s02, s12 = r[..., 0, 1] + r[..., 1, 0], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 2] + r[..., 2, 1]
    rows = [
        t, a, b, c,
        a, 2 * r[..., 0, 0] - t, s01, s02,
        b, s01, 2 * r[..., 1, 1] - t, s12,
        c, s02, s12, 2 * r[..., 2, 2] - t,
    ]  # fmt: skip
    k = xp.stack(rows, -1).reshape(*r.shape[:-2], 4, 4)
    return xp.linalg.eigh(k)[1][..., -1]


def add_point_mass(
    xp: Any, mass: Array, ipos: Array, inertia: Array, iquat: Array, extra: Array, point: Array
) -> tuple[Array, Array, Array, Array]:
    """Rigid body [...] plus a point mass: (mass, ipos [..., 3], diagonal inertia [..., 3], iquat [..., 4])."""
    total = mass + extra
    centre = (mass[..., None] * ipos + extra[..., None] * point) / total[..., None]

    def shifted(m: Array, d: Array) -> Array:
        square = (d * d).sum(-1)[..., None, None] * np.eye(3)
        return m[..., None, None] * (square - d[..., :, None] * d[..., None, :])

    r = rotation_of(iquat, xp)
    full = (r * inertia[..., None, :]) @ xp.swapaxes(r, -1, -2)
    full = full + shifted(mass, ipos - centre) + shifted(extra, point - centre)
    values, vectors = xp.linalg.eigh(full)
    flip = xp.where(xp.linalg.det(vectors) < 0, -1.0, 1.0)[..., None, None]
    return total, centre, values, quaternion_of(vectors * flip, xp)
