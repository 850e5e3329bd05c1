"""A corrected machine in JAX: MuJoCo with the effects' own equations, behind the engine protocol of environments."""

from __future__ import annotations

from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np

from mpge_jax.diagnosis.corrected.physics import physics_of
from mpge_jax.diagnosis.simulation import single_step
from mpge_jax.diagnosis.simulation.single_step import Machine


@flax.struct.dataclass
class CorrectedData:
    """Physics state with the effects' memories.

    Attributes:
        inner: the engine's data of the true state. qpos [nq], qvel [nv]: as measured. time: s.
        commands, forces: memories of the effects. past: [H, nq + nv] positions and velocities of the last steps, newest
            first.
        started: whether the command memories hold real commands yet.
    """

    inner: Any
    qpos: jax.Array
    qvel: jax.Array
    time: jax.Array
    commands: Any
    forces: Any
    past: jax.Array
    started: jax.Array


class CorrectedEngine:
    """`init` and `step` of a machine with effects; both are pure, for one machine; batch with `jax.vmap`.

    Args:
        machine: what is moved. backend: `c`, `mjx`, or `auto` (see `physics.physics_of`).

    Raises:
        ValueError: the model uses something that MJX leaves out.
    """

    def __init__(self, machine: Machine, backend: str = "mjx") -> None:
        self.machine = machine
        self.model = machine.model
        self.physics = physics_of(machine, backend)
        self._dt = float(self.model.opt.timestep)
        delays = [delay for _, delay in machine.senses().values()]
        self._history = int(np.ceil(max(delays, default=0.0) / self._dt)) + 2

    def init(self, qpos: jax.Array, qvel: jax.Array) -> CorrectedData:
        """State at rest of all memories."""
        data = self.physics.start(jnp.asarray(qpos), jnp.asarray(qvel))
        zero = jnp.zeros(self.model.nu, data.qpos.dtype)
        commands = single_step.command_start(jnp, self.machine, zero, self._dt)
        forces = single_step.force_start(jnp, self.machine, self._observe(data, zero))
        past = jnp.tile(jnp.concatenate([data.qpos, data.qvel]), (self._history, 1))
        return self._wrap(data, commands, forces, past, jnp.zeros((), bool))

    def step(self, data: CorrectedData, ctrl: jax.Array, count: int) -> CorrectedData:
        """`count` physics steps under `ctrl [nu]` held constant."""
        fresh_commands = single_step.command_start(jnp, self.machine, ctrl, self._dt)
        commands = jax.tree.map(
            lambda new, old: jnp.where(data.started, old, new), fresh_commands, data.commands
        )
        reached, _ = single_step.command_step(jnp, self.machine, ctrl, commands, self._dt)
        fresh_forces = single_step.force_start(jnp, self.machine, self._observe(data.inner, reached))
        forces = jax.tree.map(lambda new, old: jnp.where(data.started, old, new), fresh_forces, data.forces)
        start = (data.inner, commands, forces, data.past)
        inner, commands, forces, past = jax.lax.fori_loop(0, count, lambda _, c: self._once(c, ctrl), start)
        return self._wrap(inner, commands, forces, past, jnp.ones((), bool))

    def _once(self, carry: tuple[Any, ...], ctrl: jax.Array) -> tuple[Any, ...]:
        data, commands, forces, past = carry
        reached, commands = single_step.command_step(jnp, self.machine, ctrl, commands, self._dt)
        s = self._observe(data, reached)
        applied, forces = single_step.force_step(jnp, self.machine, s, forces)
        data = self.physics.step(data, applied)
        past = jnp.concatenate([jnp.concatenate([data.qpos, data.qvel])[None], past[:-1]])
        return data, commands, forces, past

    def _observe(self, data: Any, ctrl: jax.Array) -> Any:
        read = self.physics.read

        def body_velocity(body: int) -> jax.Array:
            root = int(self.model.body_rootid[body])
            arm = read(data, "xipos")[body] - read(data, "subtree_com")[root]
            speed = read(data, "cvel")[body]
            return speed[3:] + jnp.cross(speed[:3], arm)

        return single_step.observe(
            jnp,
            self.machine,
            data.qpos,
            data.qvel,
            ctrl,
            body_velocity,
            read(data, "actuator_force"),
            self._dt,
            read(data, "qfrc_bias"),
            lambda dof: self.physics.inertia(data, dof),
        )

    def _wrap(
        self, data: Any, commands: Any, forces: Any, past: jax.Array, started: jax.Array
    ) -> CorrectedData:
        qpos, qvel = data.qpos, data.qvel
        for column, (offset, delay) in self.machine.senses().items():
            qpos = qpos.at[column].set(self._before(past[:, column], delay) + offset)
        for dof, delay in self.machine.late_speeds().items():
            qvel = qvel.at[dof].set(self._before(past[:, self.model.nq + dof], delay))
        return CorrectedData(data, qpos, qvel, data.time, commands, forces, past, started)

    def _before(self, past: jax.Array, delay: float) -> jax.Array:
        """What one of `past` [H] was `delay` seconds ago, between two steps."""
        whole, part = divmod(delay / self._dt, 1.0)
        k = int(whole)
        return past[0] if delay <= 0 else (1 - part) * past[k] + part * past[min(k + 1, self._history - 1)]
