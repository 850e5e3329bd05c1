"""Fields of the compiled model as elements and attributes of MJCF: how an effect becomes part of `corrected.xml`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.step import Array, Fields


class SpecFields(Fields):
    """Compiled values of a spec; what is set goes into the spec's elements as well."""

    xp = np

    def __init__(self, spec: mujoco.MjSpec) -> None:
        self.spec = spec
        self.model = spec.compile()

    def get(self, name: str, index: Any) -> Array:
        return np.array(field_of(self.model, name)[index], dtype=float)

    def set(self, name: str, index: Any, value: Array) -> None:
        if not has_form((name,)):
            raise ValueError(f"MJCF has no attribute for {name}: list it among the effect's `fields`.")
        array = field_of(self.model, name)
        before = np.array(array)
        array[index] = value
        if name.startswith("opt."):
            setattr(self.spec.option, name.removeprefix("opt."), np.array(array))
            return
        changed = (array != before).reshape(len(array), -1).any(axis=1)
        for row in np.flatnonzero(changed):
            _WRITERS[name](self, int(row), array[row])


def has_form(fields: Iterable[str]) -> bool:
    """Whether MJCF has an attribute for each of these fields (for none: no)."""
    fields = tuple(fields)
    return bool(fields) and all(f in _WRITERS or f == "opt.gravity" for f in fields)


def field_of(model: mujoco.MjModel, name: str) -> np.ndarray:
    """The array of a field such as `dof_damping` or `opt.gravity`."""
    owner, _, attribute = name.rpartition(".")
    return getattr(model.opt if owner == "opt" else model, attribute)


def element(elements: Any, index: int) -> Any:
    """The element of that index in the compiled model's order."""
    return next(e for e in elements if e.id == index)


def _inertial(f: SpecFields, b: int, _value: Array) -> None:
    """Write explicit inertial properties; the body's geoms keep their shapes and lose their masses' say."""
    _let_inertials_count(f.spec)
    m, body = f.model, element(f.spec.bodies, b)
    body.explicitinertial = True
    body.mass = float(m.body_mass[b])
    body.ipos, body.iquat, body.inertia = (
        np.array(x[b]) for x in (m.body_ipos, m.body_iquat, m.body_inertia)
    )
    body.fullinertia = np.full(6, np.nan)
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _let_inertials_count(spec: mujoco.MjSpec) -> None:
    """Where the compiler takes every mass from geoms, whatever is written: let it do so for bodies that have any and
    state no inertial properties, which is the same until some are stated."""
    if spec.compiler.inertiafromgeom != mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        return
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    for body in spec.bodies[1:]:
        if body.geoms:
            body.explicitinertial, body.ipos = False, [np.nan] * 3


def _joint(f: SpecFields, dof: int) -> Any:
    return element(f.spec.joints, int(f.model.dof_jntid[dof]))


def _polynomial(name: str, powers: slice) -> Callable[..., None]:
    """Some coefficients of a joint's damping or stiffness."""

    def write(f: SpecFields, index: int, value: Array) -> None:
        joint = element(f.spec.joints, index) if name == "stiffness" else _joint(f, index)
        table = np.array(getattr(joint, name), dtype=float)
        table[powers] = value
        setattr(joint, name, table)

    return write


def _spring_reference(f: SpecFields, q: int, value: Array) -> None:
    joint = element(f.spec.joints, int(np.flatnonzero(f.model.jnt_qposadr == q)[0]))
    joint.springref = float(value)
    # a joint that came with another model is in that model's unit, which nothing but the compiler knows
    read = float(f.spec.copy().compile().qpos_spring[q])
    if not np.isclose(read, value, rtol=1e-6, atol=1e-12):
        joint.springref = float(np.rad2deg(value))


def _attribute(elements: str, name: str, make: Callable[[Any], Any] = np.array) -> Callable[..., None]:
    def write(f: SpecFields, index: int, value: Array) -> None:
        setattr(element(getattr(f.spec, elements), index), name, make(value))

    return write


def _wide(limits: Array) -> Array:
    """Limits that MuJoCo accepts: it takes no force that is always the same."""
    low, high = map(float, limits)
    return np.array([low, max(high, low + 1e-3 * max(abs(low), 1e-3))])


def _of_dof(name: str, make: Callable[[Any], Any] = np.array) -> Callable[..., None]:
    def write(f: SpecFields, dof: int, value: Array) -> None:
        setattr(_joint(f, dof), name, make(value))

    return write


_WRITERS: dict[str, Callable[[SpecFields, int, Array], Any]] = {
    "actuator_gainprm": _attribute("actuators", "gainprm"),
    "actuator_biasprm": _attribute("actuators", "biasprm"),
    "actuator_biastype": _attribute("actuators", "biastype", lambda v: mujoco.mjtBias(int(v))),
    "actuator_forcerange": _attribute("actuators", "forcerange", _wide),
    "actuator_forcelimited": _attribute("actuators", "forcelimited", int),
    "actuator_armature": _attribute("actuators", "armature", float),
    "body_gravcomp": _attribute("bodies", "gravcomp", float),
    "body_mass": _inertial,
    "body_ipos": _inertial,
    "body_inertia": _inertial,
    "body_iquat": _inertial,
    "dof_armature": _of_dof("armature", float),
    "dof_damping": _polynomial("damping", slice(0, 1)),
    "dof_dampingpoly": _polynomial("damping", slice(1, 3)),
    "dof_frictionloss": _of_dof("frictionloss", float),
    "dof_solref": _of_dof("solref_friction"),
    "dof_solimp": _of_dof("solimp_friction"),
    "geom_friction": _attribute("geoms", "friction"),
    "geom_solref": _attribute("geoms", "solref"),
    "jnt_stiffness": _polynomial("stiffness", slice(0, 1)),
    "pair_friction": _attribute("pairs", "friction"),
    "pair_solref": _attribute("pairs", "solref"),
    "qpos_spring": _spring_reference,
}
