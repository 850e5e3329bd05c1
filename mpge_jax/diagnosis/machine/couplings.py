"""Joints of which an equality with another joint tells the position, where that was not measured."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import is_scalar

Array = np.ndarray


@dataclass(frozen=True)
class Led:
    """A hinge or slide that follows another one: its position, from that of the model on, is a polynomial of the
    other's.

    Attributes:
        joint, by: indices of joints. polynomial: of the other's position (rad or m), from the model's on.
    """

    joint: int
    by: int
    polynomial: np.polynomial.Polynomial

    def along(self, model: mujoco.MjModel, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array, Array]:
        """Position, speed and acceleration [T] of the joint along a motion [T, nq], [T, nv], [T, nv] of the other, and
        by how much its position changes with the other's."""
        column, dof = model.jnt_qposadr[self.by], model.jnt_dofadr[self.by]
        x, speed = q[:, column] - model.qpos0[column], v[:, dof]
        slope = self.polynomial.deriv()(x)
        bend = self.polynomial.deriv(2)(x)
        start = model.qpos0[model.jnt_qposadr[self.joint]]
        return start + self.polynomial(x), slope * speed, slope * a[:, dof] + bend * speed**2, slope


def led(model: mujoco.MjModel, missing: Array) -> list[Led]:
    """Joints that equalities tell from measured ones, in an order in which each follows one that is known by then.

    Args:
        missing: [nq] columns of the positions that were not measured.
    """
    known = {j for j in range(model.njnt) if is_scalar(model, j) and not missing[model.jnt_qposadr[j]]}
    ways = [way for e in range(model.neq) for way in _ways(model, e)]
    out: list[Led] = []
    while more := next((x for x in ways if x.by in known and x.joint not in known), None):
        known.add(more.joint)
        out.append(more)
    return out


def _ways(model: mujoco.MjModel, equality: int) -> list[Led]:
    """In which way an equality tells one joint from the other: both ways where that is linear."""
    joint, by = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    kind, active = model.eq_type[equality], model.eq_active0[equality]
    if kind != mujoco.mjtEq.mjEQ_JOINT or not active or by < 0:
        return []
    first, slope, *rest = model.eq_data[equality, :5].tolist()
    ways = [Led(joint, by, np.polynomial.Polynomial([first, slope, *rest]))]
    if slope and not any(rest):
        ways.append(Led(by, joint, np.polynomial.Polynomial([-first / slope, 1.0 / slope])))
    return ways
