"""Which parameters of a model were corrected: the numbers that differ between two compiled models of one machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import is_scalar, names_of

Array = np.ndarray


@dataclass(frozen=True)
class Quantity:
    """A parameter of one kind of element: its name in MJCF and how to read it from a compiled model."""

    kind: str
    name: str
    read: Callable[[mujoco.MjModel, int], Array]
    unit: Callable[[mujoco.MjModel, int], str] | str = ""


@dataclass(frozen=True)
class Change:
    """One parameter of one element, as given and as corrected: numbers [n] in SI units. index: of the element."""

    quantity: Quantity
    at: str
    index: int
    given: Array
    corrected: Array
    unit: str

    def __str__(self) -> str:
        return f"{self.quantity.name} of {self.quantity.kind} {self.at}".removesuffix(" of world world")


def inertia_in_body(m: mujoco.MjModel, body: int) -> Array:
    """Inertia [3, 3] about the centre of mass, in the axes of the body."""
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, m.body_iquat[body])
    turn = axes.reshape(3, 3)
    return turn @ np.diag(m.body_inertia[body]) @ turn.T


def _six(m: mujoco.MjModel, body: int) -> Array:
    full = inertia_in_body(m, body)
    return np.array([*np.diag(full), full[0, 1], full[0, 2], full[1, 2]])


def _polynomial(plain: str, powers: str) -> Callable[[mujoco.MjModel, int], Array]:
    def read(m: mujoco.MjModel, j: int) -> Array:
        i = m.jnt_dofadr[j] if plain.startswith("dof") else j
        return np.append(getattr(m, plain)[i], getattr(m, powers)[i])

    return read


def _of_dof(field: str) -> Callable[[mujoco.MjModel, int], Array]:
    return lambda m, j: np.atleast_1d(getattr(m, field)[m.jnt_dofadr[j]])


def _row(field: str) -> Callable[[mujoco.MjModel, int], Array]:
    return lambda m, i: np.atleast_1d(np.asarray(getattr(m, field)[i], dtype=float))


def _by_joint(hinge: str, slide: str) -> Callable[[mujoco.MjModel, int], str]:
    return lambda m, j: slide if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE else hinge


def _springref(m: mujoco.MjModel, j: int) -> Array:
    return np.atleast_1d(m.qpos_spring[m.jnt_qposadr[j]]) if is_scalar(m, j) else np.zeros(1)


QUANTITIES = (
    Quantity("joint", "damping", _polynomial("dof_damping", "dof_dampingpoly"), _by_joint("N m s/rad", "N s/m")),
    Quantity("joint", "frictionloss", _of_dof("dof_frictionloss"), _by_joint("N m", "N")),
    Quantity("joint", "armature", _of_dof("dof_armature"), _by_joint("kg m^2", "kg")),
    Quantity("joint", "stiffness", _polynomial("jnt_stiffness", "jnt_stiffnesspoly"), _by_joint("N m/rad", "N/m")),
    Quantity("joint", "springref", _springref, _by_joint("rad", "m")),
    Quantity("joint", "solreffriction", _of_dof("dof_solref")),
    Quantity("joint", "solimpfriction", _of_dof("dof_solimp")),
    Quantity("body", "mass", _row("body_mass"), "kg"),
    Quantity("body", "com", _row("body_ipos"), "m, in the body's frame"),
    Quantity("body", "inertia", _six, "kg m^2, xx yy zz xy xz yz about the centre of mass in the body's axes"),
    Quantity("body", "gravcomp", _row("body_gravcomp")),
    Quantity("actuator", "gainprm", _row("actuator_gainprm")),
    Quantity("actuator", "biasprm", _row("actuator_biasprm")),
    Quantity("actuator", "biastype", _row("actuator_biastype")),
    Quantity("actuator", "forcelimited", _row("actuator_forcelimited")),
    Quantity("actuator", "forcerange", _row("actuator_forcerange")),
    Quantity("actuator", "armature", _row("actuator_armature")),
    Quantity("geom", "friction", _row("geom_friction")),
    Quantity("geom", "solref", _row("geom_solref")),
    Quantity("pair", "friction", _row("pair_friction")),
    Quantity("pair", "solref", _row("pair_solref")),
    Quantity("world", "gravity", lambda m, _: np.array(m.opt.gravity), "m/s^2"),
)  # fmt: skip
"""What effects write into MJCF (`effects.native`), by the kind of element that holds it."""


def differences(given: mujoco.MjModel, corrected: mujoco.MjModel, tolerance: float = 1e-9) -> list[Change]:
    """What `corrected` has otherwise than `given`, of which it is an edited copy."""
    names = names_of(given)
    elements = {
        "joint": names.joints,
        "body": names.bodies,
        "actuator": names.actuators,
        "geom": names.geoms,
        "pair": tuple(given.pair(i).name or f"pair_{i}" for i in range(given.npair)),
        "world": ("world",),
    }
    out = []
    for quantity in QUANTITIES:
        for i, at in enumerate(elements[quantity.kind]):
            before, after = quantity.read(given, i), quantity.read(corrected, i)
            if not same(before, after, tolerance):
                unit = quantity.unit if isinstance(quantity.unit, str) else quantity.unit(given, i)
                out.append(Change(quantity, at, i, before, after, unit))
    return out


def same(a: Array, b: Array, tolerance: float) -> bool:
    """Whether two readings agree, each number by its own size and that of the largest."""
    scale = max(float(np.abs(a).max(initial=0.0)), float(np.abs(b).max(initial=0.0)))
    return bool(np.allclose(a, b, rtol=tolerance, atol=tolerance * scale))


def table(changes: list[Change]) -> dict[str, dict[str, dict[str, dict[str, object]]]]:
    """The changes as plain data: kind -> element -> parameter -> given, corrected, unit."""
    plural = {"body": "bodies", "world": "world"}
    out: dict[str, dict[str, dict[str, dict[str, object]]]] = {}
    for c in changes:
        row = {"given": plain(c.given), "corrected": plain(c.corrected)} | (
            {"unit": c.unit} if c.unit else {}
        )
        kind = plural.get(c.quantity.kind, f"{c.quantity.kind}s")
        out.setdefault(kind, {}).setdefault(c.at, {})[c.quantity.name] = row
    return out


def plain(values: Array) -> object:
    """A number, or a list without the zeros at its end, in nine digits."""
    numbers = trimmed(values)
    return numbers[0] if len(numbers) == 1 else numbers


def trimmed(values: Array) -> list[float]:
    """Numbers in nine digits, without zeros at the end but for the first."""
    numbers = [float(f"{x:.9g}") for x in values]
    while len(numbers) > 1 and numbers[-1] == 0.0:
        numbers.pop()
    return numbers
