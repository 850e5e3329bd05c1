"""Where in space a part of the machine is, for pictures that mark it."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import is_scalar

Array = np.ndarray
_JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
_SITES = (int(mujoco.mjtTrn.mjTRN_SITE), int(mujoco.mjtTrn.mjTRN_SLIDERCRANK))


@dataclass(frozen=True)
class Mark:
    """A place to show: its kind and index in the model, and the lines that are written beside it."""

    kind: str
    index: int
    label: str


@dataclass(frozen=True)
class Spot:
    """A point with what is painted there.

    Attributes:
        point: [3] m, in the world. along: [3] unit vector of the axis or line of push (zero: none). bodies, geoms:
            indices.
    """

    point: Array
    along: Array
    bodies: tuple[int, ...] = ()
    geoms: tuple[int, ...] = ()


def find(model: mujoco.MjModel, data: mujoco.MjData, mark: Mark) -> Spot | None:
    """The spot of a mark, for a model whose positions are computed; None for what is everywhere (the world)."""
    still = np.zeros(3)
    if mark.kind == "joint":
        return _joint(model, data, mark.index)
    if mark.kind == "body":
        return Spot(data.xipos[mark.index].copy(), still, bodies=(mark.index,))
    if mark.kind == "geom":
        return Spot(data.geom_xpos[mark.index].copy(), still, geoms=(mark.index,))
    if mark.kind == "actuator":
        kind, target = int(model.actuator_trntype[mark.index]), int(model.actuator_trnid[mark.index, 0])
        if kind in _JOINTS:
            return _joint(model, data, target)
        if kind in _SITES:
            push = data.site_xmat[target].reshape(3, 3) @ model.actuator_gear[mark.index, :3]
            return Spot(data.site_xpos[target].copy(), push / max(float(np.linalg.norm(push)), 1e-12))
        if kind == mujoco.mjtTrn.mjTRN_BODY:
            return Spot(data.xipos[target].copy(), still, bodies=(target,))
        if kind == mujoco.mjtTrn.mjTRN_TENDON:
            return _tendon(model, data, target)
    return None


def _joint(model: mujoco.MjModel, data: mujoco.MjData, joint: int) -> Spot:
    along = data.xaxis[joint].copy() if is_scalar(model, joint) else np.zeros(3)
    return Spot(data.xanchor[joint].copy(), along)


def _tendon(model: mujoco.MjModel, data: mujoco.MjData, tendon: int) -> Spot | None:
    """The middle of the joints or sites that a tendon joins."""
    first = int(model.tendon_adr[tendon])
    points = []
    for i in range(first, first + int(model.tendon_num[tendon])):
        kind, target = int(model.wrap_type[i]), int(model.wrap_objid[i])
        if kind == mujoco.mjtWrap.mjWRAP_JOINT:
            points.append(data.xanchor[target])
        elif kind == mujoco.mjtWrap.mjWRAP_SITE:
            points.append(data.site_xpos[target])
    return Spot(np.mean(points, axis=0), np.zeros(3)) if points else None
