"""Effects whose forces are computed at every step, for many simulations of a batch at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.step import Forces, Step
from mpge_jax.diagnosis.machine.model import (
    TAKEN,
    command_limits,
    free_inertia,
    has_plain_law,
    is_joint_transmission,
    within,
)
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray


DIVERGED = 1e5
"""Speed (rad/s or m/s) from which a simulation is given up."""
STEPS_BEFORE = 800
"""Steps, about, in which at most all that went before a window is followed: none finer than a millisecond, as an error
there fades until the window begins."""


@dataclass
class Group:
    """Simulations on which one runtime effect acts.

    Attributes:
        constant: what equations read that stays (`Runtime.constant`), of these simulations.
    """

    term: Term
    rows: Array
    theta: Array
    memory: Any = None
    constant: tuple[Array, ...] = ()


class Runtime:
    """Effects whose forces are computed each step, vectorised over the simulations on which they act."""

    def __init__(
        self, model: mujoco.MjModel, ctx: Context, batch: Batch, groups: list[Group], push: Array, dt: float
    ) -> None:
        self.model, self.ctx, self.batch, self.groups = model, ctx, batch, groups
        self.push, self.dt, self.batch_size = push, dt, len(push)
        m = model
        self.qpos, self.qvel = batch.bind("qpos"), batch.bind("qvel")
        self.ctrl = batch.bind("ctrl") if m.nu else None
        self.qfrc = batch.bind("qfrc_applied")
        self.xfrc = batch.bind("xfrc_applied")
        self.dry_base = None
        if any("dof_frictionloss" in g.term.effect.fields for g in groups):
            self.dry = batch.expand("dof_frictionloss")
            self.dry_base = self.dry.copy()
        self.bodies = any(g.term.place.kind == "body" for g in groups)
        if self.bodies:
            self.cvel, self.xipos, self.com = (batch.bind(k) for k in ("cvel", "xipos", "subtree_com"))
        self.loaded = any(g.term.effect.external for g in groups)
        self.loads = batch.bind("qfrc_bias") if self.loaded else np.zeros((0, 0))
        self.factor = batch.bind("qLD") if any(g.term.effect.inertial for g in groups) else None
        self.gain = _expanded(batch, m, "actuator_gainprm")
        self.bias = _expanded(batch, m, "actuator_biasprm")
        self.range = _expanded(batch, m, "actuator_forcerange").copy()
        limited = _expanded(batch, m, "actuator_forcelimited").astype(bool)
        self.range[~np.broadcast_to(limited, self.range.shape[:-1])] = [-1e12, 1e12]
        self.taken = bool(self.bias[..., TAKEN].any())
        affine = _expanded(batch, m, "actuator_biastype") == int(mujoco.mjtBias.mjBIAS_AFFINE)
        self.bias = np.where(affine[..., None], self.bias, 0.0)
        # each [n, nu]
        self.constant = self.low, self.high, self.stiffness, self.damping = tuple(
            np.broadcast_to(x, (self.batch_size, m.nu))
            for x in (
                self.range[..., 0],
                self.range[..., 1],
                self.bias[..., 1],
                self.bias[..., 2] + self.bias[..., TAKEN],
            )
        )
        for g in groups:
            g.constant = tuple(x.take(g.rows, 0) for x in self.constant)
        self.least, self.most = command_limits(m)
        self.formula = np.array([has_plain_law(m, a) for a in range(m.nu)], dtype=bool)
        self.last_force = batch.bind("actuator_force") if m.nu and not self.formula.all() else None
        joints = m.actuator_trnid[:, 0] if m.nu else np.zeros(0, int)
        self.qadr = np.where(self.formula, m.jnt_qposadr[np.clip(joints, 0, m.njnt - 1)], 0)
        self.dadr = np.where(self.formula, m.jnt_dofadr[np.clip(joints, 0, m.njnt - 1)], 0)
        self.gear = m.actuator_gear[:, 0] if m.nu else np.zeros(0)

    def _step(self) -> Step:
        return self._observe(self.qpos, self.qvel, self.ctrl)

    def _observe(
        self, q: Array, v: Array, u: Array | None, rows: Array | None = None, dt: float | None = None
    ) -> Step:
        """What the equations may read of some simulations (all, by default) in states q, v under commands u, for a step
        of `dt` s (the engine's, by default)."""
        dt = self.dt if dt is None else dt

        def of(x: Array) -> Array:
            return x if rows is None or len(x) == 1 else x.take(rows, 0)

        def velocity(body: int) -> Array:
            return of(self._body_velocity(body))

        def external(dof: int) -> Array:
            return of(self._external(dof))

        def inertia(dof: int) -> Array:
            return of(self._inertia(dof))

        if u is None:
            none = np.zeros((q.shape[0], 0))
            undriven = (none,) * 7
            return Step(q, v, *undriven, velocity, dt, external, None, inertia)
        length, speed = self.gear * q[:, self.qadr], self.gear * v[:, self.dadr]
        gain, bias = of(self.gain), of(self.bias)
        low, high, stiffness, damping = map(of, (self.low, self.high, self.stiffness, self.damping))
        command = within(u, self.least, self.most)
        slow = gain[..., 0] * command + bias[..., 0] + bias[..., 1] * length
        free = slow + damping * speed
        f = within(free, low, high)
        engine = within(slow + bias[..., 2] * speed, low, high) if self.taken else None
        if self.last_force is not None:
            last = of(self.last_force)
            free, f = np.where(self.formula, free, last), np.where(self.formula, f, last)
            engine = None if engine is None else np.where(self.formula, engine, last)
        return Step(q, v, u, f, free, low, high, stiffness, damping, velocity, dt, external, engine, inertia)

    def _external(self, dof: int) -> Array:
        """Torque of gravity and of the other links' motion on a joint, one substep behind."""
        if not self.loaded:
            raise ValueError("an effect whose `force` reads `Step.external` must set `external = True`.")
        return -self.loads[:, dof]

    def _inertia(self, dof: int) -> Array:
        """Inertia with which a joint resists a torque, one substep behind."""
        if self.factor is None:
            raise ValueError("an effect whose `force` reads `Step.inertia` must set `inertial = True`.")
        return free_inertia(self.model, self.factor, dof)

    def _body_velocity(self, body: int) -> Array:
        """World velocity of the centre of mass, one substep behind."""
        root = int(self.model.body_rootid[body])
        arm = self.xipos[:, body] - self.com[:, root]
        return self.cvel[:, body, 3:] + np.cross(self.cvel[:, body, :3], arm)

    def begin(self, w: Windows, window: Array, moved: Array, commanded: Callable[[int], Array]) -> None:
        """Memories at the start of the windows.

        Args:
            window: [n] of each simulation. moved: [n, nv] change of the start's velocity. commanded: gives the commands
                [n, nu] of a step, negative before the start.
        """
        self.recall()
        s, past = self._step(), None
        for g in self.groups:
            seconds = g.term.effect.remembers(self.ctx, g.term.place, g.theta)
            steps = np.minimum(np.ceil(seconds / w.dt), w.history).astype(int)
            if steps.any():
                past = w.before(self.model) if past is None else past
                part = _rows(s, g.rows, g.constant)
                g.memory = self._followed(g, steps, w, window[g.rows], moved[g.rows], commanded, part, past)

    def refresh(self) -> None:
        """Let what equations read of the engine follow from the present states."""
        if self.bodies or self.loaded or self.factor is not None or self.last_force is not None:
            self.batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_ACC))

    def recall(self, some: Array | None = None) -> None:
        """Memories as the present states alone tell them, of `some` [n] simulations (all, by default)."""
        self.refresh()
        s = self._step()
        for g in self.groups:
            part, effect = _rows(s, g.rows, g.constant), g.term.effect
            memory = effect.memory(np, self.ctx, g.term.place, g.theta, part)
            g.memory = memory if some is None else either(some[g.rows], memory, g.memory)
            if g.term.place.kind == "actuator":
                forces, _ = effect.force(np, self.ctx, g.term.place, g.theta, part, memory)
                self._pass_on(s, g, g.rows, forces)

    def _followed(
        self,
        g: Group,
        steps: Array,
        w: Windows,
        window: Array,
        moved: Array,
        commanded: Callable[[int], Array],
        now: Step,
        past: tuple[Array, Array, Array],
    ) -> Any:
        """The memory at the start after as many `steps` [n] of the joint's recorded motion, where there are so many.
        Where a start is moved, the motion before it is moved along."""
        effect, place, each = g.term.effect, g.term.place, np.arange(window.size)
        qadr, dof, count = self.ctx.qadr(place), self.ctx.dof(place), int(steps.max())
        past_q, past_v, ago = (x[window, -count:] for x in past)
        aside, moved_v = now.q[:, qadr] - w.q0[window, qadr], moved[:, dof]
        before = [
            (other, *np.intersect1d(g.rows, other.rows, return_indices=True)[1:])
            for other in self.groups
            if other.term.place.kind == "actuator"
        ]
        q, v, memory, followed = now.q.copy(), now.v.copy(), g.memory, np.zeros(window.size, bool)
        stride = max(1, w.history // STEPS_BEFORE)
        follow = effect.follower(self.ctx, place, g.theta, stride * self.dt)

        def row(k: int) -> Array:
            """That of the recorded motion at a step, or the first one that is followed."""
            return np.maximum(k, count - np.maximum(steps, 1))

        def moves(k: int) -> tuple[Array, Array]:
            """The joint at a step before the start."""
            if k == count:
                return now.q[:, qadr], now.v[:, dof]
            at = row(k)
            here = past_q[each, at, qadr] + aside - moved_v * ago[each, at]
            return here, past_v[each, at, dof] + moved_v

        then = moves(count % stride)
        for k in range(count % stride, count, stride):
            (q[:, qadr], v[:, dof]), then = then, moves(k + stride)
            command = np.mean([commanded(k - count + i)[g.rows] for i in range(stride)], axis=0)
            s = self._observe(q, v, command, g.rows, stride * self.dt)
            for other, mine, theirs in before:
                part, drive, at_drive = (
                    _rows(s, mine),
                    other.term.effect,
                    (other.term.place, other.theta[theirs]),
                )
                remembered = drive.memory(np, self.ctx, *at_drive, part)
                forces, _ = drive.force(np, self.ctx, *at_drive, part, remembered)
                self._pass_on(s, other, mine, forces)
            known = (k >= count - steps) & (ago[each, row(k)] > w.dt * (count - k) - 1e-9)
            if not followed.all():
                memory = either(followed, memory, effect.memory(np, self.ctx, place, g.theta, s))
            memory, followed = either(known, follow(s, then, memory), memory), followed | known
        return either(followed, memory, g.memory)

    def _pass_on(self, s: Step, g: Group, rows: Array, forces: Forces) -> None:
        """Let effects further down the drive train see what one does to the force of its actuator; as `Step.after`, in
        place."""
        if forces.actuator is None:
            return
        a = g.term.place.index
        known = s.added_to(is_joint_transmission(self.model, a))
        s.f[rows, a] = s.f_free[rows, a] = known[rows, a] + forces.actuator
        if s.engine is not None:
            s.engine[rows, a] += forces.actuator

    def apply(self) -> None:
        """Set the effects' forces for the next step."""
        m = self.model
        s = self._step()
        self.qfrc[:] = self.push
        if self.bodies:
            self.xfrc[:] = 0.0
        if self.dry_base is not None:
            self.dry[:] = self.dry_base
        for g in self.groups:
            effect, place, rows = g.term.effect, g.term.place, g.rows
            part = _rows(s, rows, g.constant)
            forces, g.memory = effect.force(np, self.ctx, place, g.theta, part, g.memory)
            if forces.joint is not None:
                self.qfrc[rows, self.ctx.dof(place)] += forces.joint
            if forces.dry is not None:
                self.dry[rows, self.ctx.dof(place)] += forces.dry
            if forces.body is not None:
                self.xfrc[rows, place.index, :3] += forces.body
            if forces.actuator is not None:
                a = place.index
                self._pass_on(s, g, rows, forces)
                if is_joint_transmission(m, a):
                    dof = int(m.jnt_dofadr[m.actuator_trnid[a, 0]])
                    self.qfrc[rows, dof] += self.gear[a] * forces.actuator
                else:
                    gain = np.broadcast_to(self.gain[..., a, 0], (self.batch_size,))[rows]
                    assert self.ctrl is not None
                    self.ctrl[rows, a] += forces.actuator / gain
        if self.dry_base is not None:
            np.maximum(self.dry, 0.0, out=self.dry)


def diverged(v: Array) -> Array:
    """Which simulations are given up, [..., n] of speeds [..., n, nv]."""
    return ~(np.abs(v).max(-1) < DIVERGED)


def either(choice: Array, a: Any, b: Any) -> Any:
    """Memory `a` of the simulations where `choice` [n] holds, and `b` of the others."""
    return tuple(np.where(choice, x, y) for x, y in zip(a, b, strict=True))


def _rows(s: Step, rows: Array, constant: tuple[Array, ...] | None = None) -> Step:
    """What the equations may read of some simulations.

    Args:
        constant: of these, where it is known (`Group.constant`).
    """

    def of(x: Array) -> Array:
        # several times as fast as x[rows]
        return x.take(rows, 0)

    each = s.force_low, s.force_high, s.f_position, s.f_velocity
    low, high, position, velocity = (of(x) for x in each) if constant is None else constant
    return Step(
        of(s.q),
        of(s.v),
        of(s.u),
        of(s.f),
        of(s.f_free),
        low,
        high,
        position,
        velocity,
        lambda body: of(s.body_velocity(body)),
        s.dt,
        lambda dof: of(s.external(dof)),
        None if s.engine is None else of(s.engine),
        lambda dof: of(s.inertia(dof)),
    )


def _expanded(batch: Batch, model: mujoco.MjModel, name: str) -> Array:
    """Per-simulation values [n, ...] of a field, or the shared ones [1, ...]."""
    value = batch.expanded(name)
    return np.array(value) if value is not None else np.array(getattr(model, name))[None]
