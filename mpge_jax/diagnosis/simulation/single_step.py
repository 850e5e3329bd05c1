"""Effects one step at a time, for NumPy and JAX alike: what `batch_simulator` does in bulk, for a single machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.native import field_of
from mpge_jax.diagnosis.effects.step import Array, Fields, Step
from mpge_jax.diagnosis.machine.model import TAKEN, clipped, has_plain_law, is_joint_transmission
from mpge_jax.diagnosis.simulation.slider_weights import weigh_anew


class ModelFields(Fields):
    """Fields of one MjModel, changed in place."""

    xp = np

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model

    def get(self, name: str, index: Any) -> Array:
        return np.array(
            field_of(self.model, name)[index if isinstance(index, tuple) else (index,)], dtype=float
        )

    def set(self, name: str, index: Any, value: Array) -> None:
        field_of(self.model, name)[index if isinstance(index, tuple) else (index,)] = value


@dataclass(frozen=True)
class Machine:
    """A model with its effects.

    Attributes:
        model: compiled, with native effects applied and the rest not. terms, thetas: all effects. ctx: with the
        nominal model.
    """

    model: mujoco.MjModel
    ctx: Context
    terms: tuple[Term, ...]
    thetas: tuple[np.ndarray, ...]

    @staticmethod
    def build(ctx: Context, terms: tuple[Term, ...], thetas: tuple[np.ndarray, ...]) -> Machine:
        """Apply native effects to a copy of the context's model, every term at its turn."""
        import copy

        pairs = sorted(zip(terms, thetas, strict=True), key=lambda pair: pair[0].turn)
        terms, thetas = tuple(t for t, _ in pairs), tuple(theta for _, theta in pairs)
        model = copy.copy(ctx.model)
        fields = ModelFields(model)
        for term, theta in zip(terms, thetas, strict=True):
            term.effect.model(fields, ctx, term.place, np.asarray(theta, dtype=float))
        if any(t.effect.set_const for t in terms):
            mujoco.mj_setConst(model, mujoco.MjData(model))
            weigh_anew(fields, ctx.model)
        return Machine(model, replace(ctx), terms, tuple(np.asarray(t, dtype=float) for t in thetas))

    @property
    def runtime(self) -> list[tuple[Term, np.ndarray]]:
        return [(t, th) for t, th in zip(self.terms, self.thetas, strict=True) if t.effect.runtime]

    @property
    def commanded(self) -> list[tuple[Term, np.ndarray]]:
        return [(t, th) for t, th in zip(self.terms, self.thetas, strict=True) if t.effect.commands]

    def senses(self) -> dict[int, tuple[float, float]]:
        """Offset and delay (s) of what sensors report, by column of qpos."""
        out: dict[int, tuple[float, float]] = {}
        for term, theta in zip(self.terms, self.thetas, strict=True):
            if term.effect.senses:
                column = self.ctx.qadr(term.place)
                old, new = out.get(column, (0.0, 0.0)), term.effect.sense(theta)
                out[column] = (old[0] + float(new[0]), old[1] + float(new[1]))
        return out

    def late_speeds(self) -> dict[int, float]:
        """Delay (s) of what sensors report of a speed, by column of qvel: that of the position."""
        joints = self.model.dof_jntid
        columns = {int(self.model.jnt_qposadr[joint]): dof for dof, joint in enumerate(joints)}
        return {columns[column]: delay for column, (_, delay) in self.senses().items() if delay}

    def dry_dofs(self) -> list[int]:
        """Degrees of freedom whose dry friction is set at every step."""
        return [self.ctx.dof(t.place) for t, _ in self.runtime if "dof_frictionloss" in t.effect.fields]


def command_start(xp: Any, m: Machine, ctrl: Array, dt: float) -> tuple[Any, ...]:
    """Memories of a command [nu] held for long, as it comes through the effects before each."""
    ctrl = clipped(m.model, ctrl, xp)
    reached = [ctrl[a] for a in range(m.model.nu)]
    out = []
    for term, theta in m.commanded:
        a = term.place.index
        out.append(term.effect.command_memory(xp, m.ctx, term.place, reached[a], dt))
        reached[a], _ = term.effect.command(xp, xp.asarray(theta), reached[a], out[-1], dt)
    return tuple(out)


def command_step(
    xp: Any, m: Machine, ctrl: Array, memory: tuple[Any, ...], dt: float
) -> tuple[Array, tuple[Any, ...]]:
    """Commands [nu] that reach the actuators in this step."""
    ctrl = clipped(m.model, ctrl, xp)
    out = [ctrl[a] for a in range(m.model.nu)]
    kept = []
    for (term, theta), old in zip(m.commanded, memory, strict=True):
        a = term.place.index
        out[a], new = term.effect.command(xp, xp.asarray(theta), out[a], old, dt)
        kept.append(new)
    return (xp.stack(out) if out else ctrl), tuple(kept)


def observe(
    xp: Any,
    m: Machine,
    q: Array,
    v: Array,
    ctrl: Array,
    body_velocity: Any,
    last_force: Array,
    dt: float,
    bias_force: Array,
    inertia: Callable[[int], Array],
) -> Step:
    """What the equations may read, for one machine."""
    model = m.model
    if not model.nu:
        none = xp.zeros(0)
        return Step(q, v, none, none, none, none, none, none, none, body_velocity, dt)
    plain = np.array([has_plain_law(m.ctx.model, a) for a in range(model.nu)])
    joint = np.where(plain, np.clip(model.actuator_trnid[:, 0], 0, model.njnt - 1), 0)
    gear = model.actuator_gear[:, 0]
    affine = model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
    bias = np.where(affine[:, None], model.actuator_biasprm, 0.0)
    f_limited = model.actuator_forcelimited.astype(bool)
    f_low = np.where(f_limited, model.actuator_forcerange[:, 0], -1e12)
    f_high = np.where(f_limited, model.actuator_forcerange[:, 1], 1e12)
    slow = model.actuator_gainprm[:, 0] * clipped(model, ctrl, xp) + bias[:, 0]
    slow = slow + bias[:, 1] * gear * q[model.jnt_qposadr[joint]]
    speed, brake = gear * v[model.jnt_dofadr[joint]], bias[:, 2] + bias[:, TAKEN]
    free = slow + brake * speed
    f, engine = (xp.clip(x, f_low, f_high) for x in (free, slow + bias[:, 2] * speed))
    if not plain.all():
        free, f, engine = (xp.where(plain, x, last_force) for x in (free, f, engine))
    low, high, stiffness, damping = (xp.asarray(x) for x in (f_low, f_high, bias[:, 1], brake))

    def external(dof: int) -> Array:
        return -bias_force[dof]

    return Step(
        q, v, ctrl, f, free, low, high, stiffness, damping, body_velocity, dt, external, engine, inertia
    )


def force_start(xp: Any, m: Machine, s: Step) -> tuple[Any, ...]:
    out = []
    for term, theta in m.runtime:
        effect, place, theta = term.effect, term.place, xp.asarray(theta)
        out.append(effect.memory(xp, m.ctx, place, theta, s))
        if place.kind == "actuator":
            forces, _ = effect.force(xp, m.ctx, place, theta, s, out[-1])
            s = s.after(xp, place.index, forces, is_joint_transmission(m.model, place.index))
    return tuple(out)


@dataclass
class Applied:
    """Forces of all effects at one step: qfrc [nv], xfrc [nbody, 6], dry [nv], ctrl [nu]."""

    qfrc: Array
    xfrc: Array
    dry: Array
    ctrl: Array


def force_step(xp: Any, m: Machine, s: Step, memory: tuple[Any, ...]) -> tuple[Applied, tuple[Any, ...]]:
    model = m.model
    qfrc = [xp.zeros(()) for _ in range(model.nv)]
    dry = [xp.asarray(float(x)) for x in model.dof_frictionloss]
    body = [xp.zeros(3) for _ in range(model.nbody)]
    ctrl = [s.u[a] for a in range(model.nu)]
    kept = []
    for (term, theta), old in zip(m.runtime, memory, strict=True):
        place = term.place
        forces, new = term.effect.force(xp, m.ctx, place, xp.asarray(theta), s, old)
        kept.append(new)
        if forces.joint is not None:
            qfrc[m.ctx.dof(place)] = qfrc[m.ctx.dof(place)] + forces.joint
        if forces.dry is not None:
            dry[m.ctx.dof(place)] = dry[m.ctx.dof(place)] + forces.dry
        if forces.body is not None:
            body[place.index] = body[place.index] + forces.body
        if forces.actuator is not None:
            a = place.index
            s = s.after(xp, a, forces, is_joint_transmission(model, a))
            if is_joint_transmission(model, a):
                dof = int(model.jnt_dofadr[model.actuator_trnid[a, 0]])
                qfrc[dof] = qfrc[dof] + float(model.actuator_gear[a, 0]) * forces.actuator
            else:
                ctrl[a] = ctrl[a] + forces.actuator / float(model.actuator_gainprm[a, 0])
    linear = xp.stack(body)
    xfrc = xp.concatenate([linear, xp.zeros_like(linear)], -1)
    return Applied(
        xp.stack(qfrc), xfrc, xp.maximum(xp.stack(dry), 0.0), xp.stack(ctrl) if ctrl else s.u
    ), tuple(kept)
