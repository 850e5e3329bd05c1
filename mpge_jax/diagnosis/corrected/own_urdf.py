"""Corrections put into the text of the user's own URDF, which knows damping, dry friction and inertia only."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mpge_jax.diagnosis.corrected.differences import Change, inertia_in_body
from mpge_jax.diagnosis.corrected.xml_edits import Element, XmlText, written

Array = np.ndarray
_DYNAMICS = {"damping": "damping", "frictionloss": "friction"}
_INERTIAL = ("mass", "com", "inertia")


def edit(text: XmlText, given: mujoco.MjModel, corrected: mujoco.MjModel, changes: list[Change]) -> None:
    """Write what URDF has elements for.

    A link keeps what is fixed to it: it gets the difference that the correction makes to the body that MuJoCo makes of
    both, which adds up in mass, mass times position, and inertia about the link's origin.
    """
    joints = {e.attributes.get("name"): e for e in text.root.children if e.tag == "joint"}
    links = {e.attributes.get("name"): e for e in text.root.children if e.tag == "link"}
    dynamics: dict[str, dict[str, str]] = {}
    bodies: dict[int, str] = {}
    for c in changes:
        kind, name = c.quantity.kind, c.quantity.name
        sayable = kind == "joint" and name in _DYNAMICS and not np.any(c.corrected[1:])
        if sayable and c.at in joints:
            dynamics.setdefault(c.at, {})[_DYNAMICS[name]] = f"{c.corrected[0]:.9g}"
        elif kind == "body" and name in _INERTIAL and c.at in links:
            bodies[c.index] = c.at
    for at, values in dynamics.items():
        element = joints[at].child("dynamics")
        if element is not None:
            text.set(element, values)
        else:
            text.insert(joints[at], written("dynamics", values))
    welded = {
        parent.attributes.get("link")
        for joint in joints.values()
        if joint.attributes.get("type") == "fixed" and (parent := joint.child("parent")) is not None
    }
    for body, at in bodies.items():
        link = links[at]
        before, after = _spatial_of_body(given, body), _spatial_of_body(corrected, body)
        inertial = link.child("inertial")
        # What such a link weighs by itself is known to MuJoCo alone.
        if inertial is not None or at not in welded:
            own = before if inertial is None else _spatial_of_link(inertial)
            _write_inertial(text, link, inertial, own + after - before)


def _write_inertial(text: XmlText, link: Element, inertial: Element | None, spatial: Array) -> None:
    """Write mass [1], mass times position [3] and inertia about the origin [9], if a body can have them."""
    mass = float(spatial[0])
    if not mass > 0:
        return
    com = spatial[1:4] / mass
    inertia = spatial[4:].reshape(3, 3) - _of_point(mass, com)
    if np.linalg.eigvalsh(inertia).min() < 0:
        return
    xyz = " ".join(f"{x:.9g}" for x in com)
    names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    numbers = {k: f"{inertia[i]:.9g}" for k, i in names.items()}
    parts = {"origin": {"xyz": xyz, "rpy": "0 0 0"}, "mass": {"value": f"{mass:.9g}"}, "inertia": numbers}
    if inertial is None:
        text.insert(link, f"<inertial>{''.join(written(*part) for part in parts.items())}</inertial>")
        return
    for tag, values in parts.items():
        element = inertial.child(tag)
        if element is not None:
            text.set(element, values)
        else:
            text.insert(inertial, written(tag, values))


def _spatial_of_body(m: mujoco.MjModel, body: int) -> Array:
    mass, com = float(m.body_mass[body]), np.array(m.body_ipos[body])
    about = inertia_in_body(m, body) + _of_point(mass, com)
    return np.concatenate([[mass], mass * com, about.ravel()])


def _spatial_of_link(inertial: Element) -> Array:
    def numbers(tag: str, names: tuple[str, ...], default: str) -> list[float]:
        element = inertial.child(tag)
        attributes = {} if element is None else element.attributes
        return [float(x) for name in names for x in attributes.get(name, default).split()]

    (mass,) = numbers("mass", ("value",), "0")
    com = np.array(numbers("origin", ("xyz",), "0 0 0"))
    turn = _turn(*numbers("origin", ("rpy",), "0 0 0"))
    xx, yy, zz, xy, xz, yz = numbers("inertia", ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0")
    inertia = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    return np.concatenate([[mass], mass * com, (inertia + _of_point(mass, com)).ravel()])


def _of_point(mass: float, at: Array) -> Array:
    """Inertia [3, 3] about the origin of a point mass."""
    return mass * (at @ at * np.eye(3) - np.outer(at, at))


def _turn(roll: float, pitch: float, yaw: float) -> Array:
    """Rotation [3, 3] of URDF's angles: about the fixed x, then y, then z."""
    (cx, sx), (cy, sy), (cz, sz) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return z @ y @ x
