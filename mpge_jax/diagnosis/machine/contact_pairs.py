"""Which geoms touch: by their collision masks, and in recorded poses."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

Array = np.ndarray
Pairs = tuple[tuple[int, int], ...]
NEAR = 0.02
"""Distance, over the machine's length, within which geoms may touch though they did not where rows were taken."""


def allowed_pairs(model: mujoco.MjModel) -> Pairs:
    """Pairs of geoms of different bodies that could touch by their collision masks."""
    kind, partner, body = model.geom_contype, model.geom_conaffinity, model.geom_bodyid
    meets = kind[:, None] & partner
    pairs = np.argwhere(np.triu((meets | meets.T) != 0) & (body[:, None] != body))
    return tuple((int(g), int(h)) for g, h in pairs)


def never_touches(model: mujoco.MjModel) -> bool:
    """Whether no geom or flex can touch another, in whatever pose: by masks, pairs that are told, and flexes."""
    return not (allowed_pairs(model) or model.npair or model.nflex)


def touching_pairs(model: mujoco.MjModel, poses: Array, length: float) -> Pairs:
    """Pairs of geoms that touch, or nearly do, in some of the poses [T, nq] of a machine of this length (m)."""
    wide, near = copy.copy(model), NEAR * length
    # the margins of two geoms add up; bodies pass theirs on to the search for pairs
    for margin, share in ((wide.geom_margin, 0.5), (wide.body_margin, 0.5), (wide.pair_margin, 1.0)):
        margin += share * near
    data, found = mujoco.MjData(wide), set()
    for qpos in poses:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(wide, data)
        mujoco.mj_comPos(wide, data)
        mujoco.mj_collision(wide, data)
        found |= {(int(min(g)), int(max(g))) for g in data.contact.geom[: data.ncon] if min(g) >= 0}
    return tuple(sorted(found))
