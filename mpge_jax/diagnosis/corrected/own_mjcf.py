"""Corrections put into the text of the user's own MJCF: the attributes that they name, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from mpge_jax.diagnosis.corrected.differences import Change, trimmed
from mpge_jax.diagnosis.corrected.xml_edits import Element, XmlText, written

_SHORTCUTS = {"motor": (), "position": ("kp", "kv", "dampratio"), "velocity": ("kv",)}
"""Actuators that are `general` ones with these attributes in place of numbers."""
_OPEN = ("damping", "stiffness", "gainprm", "biasprm")
"""Lists of numbers that MuJoCo fills up with zeros."""
_ORIENTATIONS = ("fullinertia", "axisangle", "xyaxes", "zaxis", "euler")


def edit(text: XmlText, corrected: mujoco.MjModel, changes: list[Change]) -> None:
    """Write changes into the elements that hold them, where there are such.

    Elements are found by their names, or, without one, by their place in the order in which MuJoCo counts them.
    """
    grouped: dict[tuple[str, int], list[Change]] = {}
    for c in changes:
        grouped.setdefault((c.quantity.kind, c.index), []).append(c)
    for (kind, index), group in grouped.items():
        element = text.root if kind == "world" else _find(text.root, corrected, kind, index)
        if element is not None:
            _write(text, element, corrected, kind, index, group)
    if any(c.quantity.name in ("mass", "com", "inertia") for c in changes):
        # Where masses are taken from geoms whatever is written: only where nothing is.
        for compiler in (e for e in text.root.children if e.attributes.get("inertiafromgeom") == "true"):
            text.set(compiler, {"inertiafromgeom": "auto"})


def _write(
    text: XmlText, element: Element, m: mujoco.MjModel, kind: str, index: int, group: list[Change]
) -> None:
    values = {c.quantity.name: _words(c.corrected, c.quantity.name in _OPEN) for c in group}
    if kind == "world":
        option = element.child("option")
        if option is None:
            text.insert(element, written("option", values))
        else:
            text.set(option, values)
    elif kind == "body":
        _write_body(text, element, m, index, values)
    elif kind == "actuator":
        _write_actuator(text, element, m, index, values)
    else:
        if "springref" in values and not _in_radians(text.root, m, index):
            values["springref"] = _words(np.rad2deg(m.qpos_spring[m.jnt_qposadr[index], None]))
        text.set(element, values)


def _write_body(text: XmlText, body: Element, m: mujoco.MjModel, index: int, values: dict[str, str]) -> None:
    if "gravcomp" in values:
        text.set(body, {"gravcomp": values.pop("gravcomp")})
    if not values:
        return
    given = {
        "pos": _words(m.body_ipos[index]),
        "quat": _words(m.body_iquat[index]),
        "mass": _words(m.body_mass[index : index + 1]),
        "diaginertia": _words(m.body_inertia[index]),
    }
    inertial = body.child("inertial")
    if inertial is not None:
        text.set(inertial, given, drop=_ORIENTATIONS)
    else:
        text.insert(body, written("inertial", given))


def _write_actuator(
    text: XmlText, element: Element, m: mujoco.MjModel, index: int, values: dict[str, str]
) -> None:
    if "forcelimited" in values:
        values["forcelimited"] = "true" if m.actuator_forcelimited[index] else "false"
    prm = {"gainprm", "biasprm", "biastype"} & set(values)
    if prm and element.tag != "general":
        if element.tag not in _SHORTCUTS or not text.is_closed(element):
            return
        values |= {
            name: _words(getattr(m, f"actuator_{name}")[index], True) for name in ("gainprm", "biasprm")
        }
    if prm:
        affine = m.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_AFFINE
        values["biastype"] = "affine" if affine else "none"
    tag = "general" if prm and element.tag != "general" else None
    text.set(element, values, drop=_SHORTCUTS[element.tag] if tag else (), tag=tag)


def _find(root: Element, m: mujoco.MjModel, kind: str, index: int) -> Element | None:
    found = list(_elements(root, kind))
    name = {"joint": m.joint, "body": m.body, "actuator": m.actuator, "geom": m.geom, "pair": m.pair}[kind](
        index
    ).name
    if name:
        return next((e for e in found if e.attributes.get("name") == name), None)
    size = {"joint": m.njnt, "body": m.nbody - 1, "actuator": m.nu, "geom": m.ngeom, "pair": m.npair}[kind]
    place = index - 1 if kind == "body" else index
    return found[place] if len(found) == size else None


def _elements(root: Element, kind: str) -> Iterator[Element]:
    """All elements of a kind in the order in which MuJoCo counts them."""
    sections = {"actuator": "actuator", "pair": "contact"}
    if kind in sections:
        for section in (e for e in root.children if e.tag == sections[kind]):
            yield from (e for e in section.children if kind == "actuator" or e.tag == "pair")
        return
    for world in (e for e in root.children if e.tag == "worldbody"):
        for body in _bodies(world):
            if kind == "body" and body is not world:
                yield body
            tags = {"joint": ("joint", "freejoint"), "geom": ("geom",)}.get(kind, ())
            yield from (e for e in _within(body) if e.tag in tags)


def _bodies(body: Element) -> Iterator[Element]:
    yield body
    for child in _within(body):
        if child.tag == "body":
            yield from _bodies(child)


def _within(body: Element) -> Iterator[Element]:
    """What belongs to a body, also inside of `frame` elements."""
    for child in body.children:
        if child.tag == "frame":
            yield from _within(child)
        else:
            yield child


def _in_radians(root: Element, m: mujoco.MjModel, joint: int) -> bool:
    """Whether an angle of that joint is written in radians."""
    compilers = [e for e in root.children if e.tag == "compiler"]
    radians = any(c.attributes.get("angle") == "radian" for c in compilers)
    return radians or m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE


def _words(values: np.ndarray, is_open: bool = False) -> str:
    return " ".join(f"{x:.9g}" for x in (trimmed(values) if is_open else values))
