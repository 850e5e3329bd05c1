"""What a residual may depend on at a joint, and over which ranges that was seen."""

from __future__ import annotations

from itertools import combinations

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.residual import ANGLE, DRIVE, LOAD, SPEED, Axis, Residual, driven_by
from mpge_jax.diagnosis.machine.model import has_plain_law, is_scalar
from mpge_jax.diagnosis.simulation.drive_signal import Source
from mpge_jax.diagnosis.simulation.measured_drives import plain_force

Array = np.ndarray
EDGES = (0.005, 0.995)
"""Quantiles of an input between which a function is told."""
ROWS = 4000
"""Rows, at most, from which ranges are taken and by which formulas are told."""


def places_of(p: Prepared, names: list[str]) -> list[Place]:
    """The joints with bearings among those names: joints, or actuators that drive a single one."""
    out = []
    for name in names:
        if name in p.names.actuators:
            name = p.names.driven_by(p.model, p.names.actuators.index(name))
        if name in p.names.joints and is_scalar(p.model, p.names.joints.index(name)):
            out.append(Place("joint", name, p.names.joints.index(name)))
    return list(dict.fromkeys(out))


def seen(p: Prepared, place: Place) -> dict[str, Array]:
    """Values [N] of every input that is known, over evenly spread rows of the training recordings."""
    total = sum(s.recording.time.size for s in p.train)
    stride = max(1, total // ROWS)
    rows = [values_of(p, s, place, stride) for s in p.train]
    return {key: np.concatenate([r[key] for r in rows]) for key in rows[0]}


def values_of(p: Prepared, s: Source, place: Place, stride: int = 1) -> dict[str, Array]:
    """Values of every input that is known, over every `stride`-th row of a recording."""
    m, which = p.model, slice(None, None, stride)
    out = values_along(p, place, s.states.qpos[which], s.states.qvel[which])
    drives = driven_by(p.ctx, place)
    if drives and all(has_plain_law(m, a) for a in drives):
        forces = [
            float(m.actuator_gear[a, 0]) * plain_force(m, a, s.command, s.states)[which] for a in drives
        ]
        out[DRIVE] = np.sum(forces, axis=0)
    return out


def values_along(p: Prepared, place: Place, qpos: Array, qvel: Array) -> dict[str, Array]:
    """Values [N] of the inputs that a motion [N, nq], [N, nv] tells by itself."""
    m, dof, load = p.model, p.ctx.dof(place), []
    data = mujoco.MjData(m)
    for q, v in zip(qpos, qvel, strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_fwdPosition(m, data)
        mujoco.mj_fwdVelocity(m, data)
        load.append(-data.qfrc_bias[dof])
    return {ANGLE: qpos[:, p.ctx.qadr(place)], SPEED: qvel[:, dof], LOAD: np.array(load)}


def functions(values: dict[str, Array]) -> list[Residual]:
    """Functions of one and of two of the inputs, over the ranges in which these lay."""
    axes = []
    for key, x in values.items():
        low, high = np.quantile(x, EDGES)
        if high - low > 1e-9 * max(1.0, float(np.abs(x).max())):
            axes.append(Axis(key, float(f"{low:.6g}"), float(f"{high:.6g}")))
    below = float(f"{max(float(np.abs(values[SPEED]).max()), 1e-6):.6g}")
    return [Residual(some, below) for k in (1, 2) for some in combinations(axes, k)]
