"""Joints at which something acts that has a place: all of them, or those where it does first."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.machine.constraints import coupled
from mpge_jax.diagnosis.machine.model import is_joint_transmission, moments


def acted_on(model: mujoco.MjModel, place: Place) -> list[int]:
    """Joints on which a place acts: a joint's own, those of an actuator, those that carry a body or a geom, or all."""
    if place.kind == "joint":
        return [place.index]
    if place.kind == "actuator":
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        dofs = np.flatnonzero(moments(model, data)[place.index])
        return sorted({int(model.dof_jntid[dof]) for dof in dofs})
    if place.kind == "world":
        return list(range(model.njnt))
    out: list[int] = []
    body = _body(model, place)
    while body:
        out += _own(model, body)
        body = int(model.body_parentid[body])
    return sorted(out)


def first_joints(model: mujoco.MjModel, place: Place) -> set[int]:
    """Joints at which something at a place acts first; all, where that is not one joint's or one body's matter. What
    acts at one joint of a loop acts at all of it."""
    if place.kind == "joint":
        joints = {place.index}
    elif place.kind == "actuator" and is_joint_transmission(model, place.index):
        joints = {int(model.actuator_trnid[place.index, 0])}
    elif place.kind in ("body", "geom"):
        joints = set(_own(model, int(model.body_weldid[_body(model, place)])))
    else:
        joints = set()
    if model.neq and joints:
        loop = set(np.flatnonzero(coupled(model)[model.jnt_dofadr]).tolist())
        joints |= loop if joints & loop else set()
    return joints or set(range(model.njnt))


def next_to(model: mujoco.MjModel, one: Term, other: Term) -> bool:
    """Whether two terms are one effect at bodies of which one carries the other: what one lacks may be the other's."""
    if one.name != other.name or one.place.kind != "body" or other.place.kind != "body":
        return False
    a, b = one.place.index, other.place.index
    return int(model.body_parentid[a]) == b or int(model.body_parentid[b]) == a


def _body(model: mujoco.MjModel, place: Place) -> int:
    return place.index if place.kind == "body" else int(model.geom_bodyid[place.index])


def _own(model: mujoco.MjModel, body: int) -> list[int]:
    first = int(model.body_jntadr[body])
    return list(range(first, first + int(model.body_jntnum[body])))
