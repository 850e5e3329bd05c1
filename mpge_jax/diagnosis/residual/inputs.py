"""What a residual may depend on at a joint, and over which ranges that was seen."""

from __future__ import annotations

import re
from itertools import combinations

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place, default_places
from mpge_jax.diagnosis.effects.residual.axis import (
    ANGLE,
    DRIVE,
    LOAD,
    NAMED,
    SPEED,
    TURNED,
    Axis,
    key_of,
    part_of_turn,
)
from mpge_jax.diagnosis.effects.residual.force import Residual, driven_by
from mpge_jax.diagnosis.effects.residual.since_turn import SinceTurn, travelled
from mpge_jax.diagnosis.machine.model import has_plain_law, is_scalar
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.measured_drives import plain_force
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
EDGES = (0.005, 0.995)
"""Quantiles of an input between which a function is told."""
TURNS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""Farthest travels since a turn, in units of the joint's typical range of motion, that are tried."""
REPEATS = (1, 2, 3, 4, 5, 6, 8, 9, 10, 12, 16, 18, 20, 24, 30, 36)
"""How often in a turn of a hinge a function may repeat."""
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


def turns(p: Prepared, place: Place) -> bool:
    """Whether a joint turns."""
    return int(p.model.jnt_type[place.index]) == int(mujoco.mjtJoint.mjJNT_HINGE)


def seen(p: Prepared, place: Place) -> dict[str, Array]:
    """Values [N] of every input that is known, by `Axis.key`, over evenly spread rows of the training recordings."""
    total = sum(s.recording.time.size for s in p.train)
    stride = max(1, total // ROWS)
    rows = [values_of(p, s, place, stride) for s in p.train]
    return {key: np.concatenate([r[key] for r in rows]) for key in rows[0]}


def values_of(p: Prepared, s: Source, place: Place, stride: int = 1) -> dict[str, Array]:
    """Values of every input that is known, over every `stride`-th row of a recording."""
    which = slice(None, None, stride)
    q, v = s.states.qpos[which], s.states.qvel[which]
    out = values_along(p, place, q, v) | _drives_along(p, place, q, v, s.command[which])
    return out | {key: x[which] for key, x in since_turns(p, place, s.states.qpos).items()}


def values_within(p: Prepared, w: Windows, place: Place, times: Array) -> dict[str, Array]:
    """Values [W, L] of every input that is known, at times [L] (s) after the starts of windows."""
    step = w.history + np.clip((times / w.dt).astype(int), 0, w.steps - 1)
    turns = {k: since_turns(p, place, w.sources[k].states.qpos) for k in set(w.source.tolist())}
    found = []
    for k, source in enumerate(w.source.tolist()):
        s, at = w.sources[source], w.start[k] + times
        q, v = s.motion_at(p.model, at)
        here = values_along(p, place, q, v) | _drives_along(p, place, q, v, w.command[k, step])
        since = {key: np.interp(at, s.recording.time, x) for key, x in turns[source].items()}
        found.append(here | since)
    return {key: np.array([x[key] for x in found]) for key in found[0]}


def _drives_along(p: Prepared, place: Place, qpos: Array, qvel: Array, command: Array) -> dict[str, Array]:
    """Forces [N] of the drives of joints whose law is plain, along a motion [N, nq], [N, nv] under commands [N, nu]."""
    m, out = p.model, {}
    for key, where in {DRIVE: place, **{key_of(DRIVE, x.name): x for x in _others(p, place)}}.items():
        drives = driven_by(p.ctx, where)
        if drives and all(has_plain_law(m, a) for a in drives):
            forces = [float(m.actuator_gear[a, 0]) * plain_force(m, a, command, qpos, qvel) for a in drives]
            out[key] = np.sum(forces, axis=0)
    return out


def _others(p: Prepared, place: Place) -> list[Place]:
    """The other joints whose inputs may count, by names that an identifier can hold."""
    joints = default_places(p.ctx, "joint")
    return [x for x in joints if x.index != place.index and re.fullmatch(NAMED, x.name)]


def values_along(p: Prepared, place: Place, qpos: Array, qvel: Array) -> dict[str, Array]:
    """Values [N] of the inputs that a motion [N, nq], [N, nv] tells by itself."""
    m, dof, load = p.model, p.ctx.dof(place), []
    data = mujoco.MjData(m)
    for q, v in zip(qpos, qvel, strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_fwdPosition(m, data)
        mujoco.mj_fwdVelocity(m, data)
        load.append(-data.qfrc_bias[dof])
    out = {ANGLE: qpos[:, p.ctx.qadr(place)], SPEED: qvel[:, dof], LOAD: np.array(load)}
    for x in _others(p, place):
        out[key_of(ANGLE, x.name)], out[key_of(SPEED, x.name)] = qpos[:, p.ctx.qadr(x)], qvel[:, p.ctx.dof(x)]
    return out


def since_turns(p: Prepared, place: Place, qpos: Array) -> dict[str, Array]:
    """Travels [T] of a joint since it turned along a whole motion [T, nq], one for each of `TURNS`."""
    q, typical = qpos[:, p.ctx.qadr(place)], float(p.ctx.travel[p.ctx.dof(place)])
    axes = [Axis.since_turn(share * typical) for share in TURNS if typical > 0]
    return {axis.key: travelled(q, axis.high) for axis in axes}


def functions(values: dict[str, Array], hinge: bool) -> list[Residual]:
    """Functions of one and of two of the inputs, over the ranges in which these lay. What turned far may be the
    same after each turn, or after each of equal parts of it.

    Of two, both are of one joint, or one is of the joint on which the function acts. Dry friction depends on its own
    joint alone; what depends on the travel since a turn depends on nothing else.

    Args:
        values: [N] by `Axis.key`. hinge: whether the joint turns.
    """
    axes, traced = [], []
    for key, x in values.items():
        if key.startswith(TURNED):
            traced.append(Axis.since_turn(float(key.removeprefix(TURNED))))
            continue
        low, high = np.quantile(x, EDGES)
        if high - low > 1e-9 * max(1.0, float(np.abs(x).max())):
            axes.append(Axis.of_key(key, float(f"{low:.6g}"), float(f"{high:.6g}")))
            if hinge and key == ANGLE:
                # what repeats was seen twice; of a whole turn, more than once
                axes += [Axis.within_turn(n) for n in REPEATS if high - low > min(n, 2) * part_of_turn(n)]
    below = float(f"{max(float(np.abs(values[SPEED]).max()), 1e-6):.6g}")
    axes.sort(key=lambda a: a.joint)
    whole = [a for a in axes if a.parts == 1]
    several = [(a, b) for a, b in combinations(whole, 2) if a.key != b.key and a.joint in ("", b.joint)]
    forces = [Residual(some, below) for some in [*((a,) for a in axes), *several]]
    forces += [SinceTurn(axis, below) for axis in traced]
    return forces + [Residual(e.axes, below, dry=True) for e in forces if not (e.coupled or e.traced)]
