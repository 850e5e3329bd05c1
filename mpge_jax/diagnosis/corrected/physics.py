"""What moves a corrected machine by one physics step under the forces of its effects: MuJoCo's C engine, or MJX."""

from __future__ import annotations

import copy
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from envs.c_engine import CEngine
from mpge_jax.diagnosis.machine.model import free_inertia, has_plain_law
from mpge_jax.diagnosis.simulation.single_step import Applied, Machine

_BODIES = ("cvel", "xipos", "subtree_com")


class Physics(Protocol):
    """One machine; batch with `jax.vmap`. What is read beside qpos and qvel is that of the step before."""

    def start(self, qpos: jax.Array, qvel: jax.Array) -> Any:
        """Physics state at qpos [nq], qvel [nv], everything computed."""

    def step(self, data: Any, applied: Applied) -> Any:
        """One physics step."""

    def read(self, data: Any, name: str) -> jax.Array:
        """`actuator_force` [nu], `qfrc_bias` [nv], `cvel` [nbody, 6], `xipos` or `subtree_com` [nbody, 3]; zeros where
        no effect of the machine reads it."""

    def inertia(self, data: Any, dof: int) -> jax.Array:
        """Inertia with which a joint resists a torque, all others being free."""


class CPhysics:
    """MuJoCo's C engine, one call for each physics step."""

    def __init__(self, machine: Machine) -> None:
        self.model = machine.model
        effects = [(t.effect, t.place) for t, _ in machine.runtime]
        seen = [*_BODIES] if any(place.kind == "body" for _, place in effects) else []
        seen += ["qfrc_bias"] if any(effect.external for effect, _ in effects) else []
        seen += ["qLD"] if any(effect.inertial for effect, _ in effects) else []
        if effects and not all(has_plain_law(machine.ctx.model, a) for a in range(self.model.nu)):
            seen.append("actuator_force")
        self._forces = ["qfrc_applied", "xfrc_applied"] if effects else []
        self._dry = ["dof_frictionloss"] if machine.dry_dofs() else []
        self._engine = CEngine(self.model, forces=self._forces, fields=self._dry, seen=seen)
        self._computes = bool(seen)

    def start(self, qpos: jax.Array, qvel: jax.Array) -> Any:
        data = self._engine.init(qpos, qvel)
        return self._engine.forward(data) if self._computes else data

    def step(self, data: Any, applied: Applied) -> Any:
        kind = data.qpos.dtype
        values = {
            "qfrc_applied": applied.qfrc,
            "xfrc_applied": applied.xfrc,
            "dof_frictionloss": applied.dry,
        }
        given = {name: values[name].astype(kind) for name in (*self._forces, *self._dry)}
        return self._engine.step(data.replace(given=given), applied.ctrl.astype(kind), 1)

    def read(self, data: Any, name: str) -> jax.Array:
        blank = {"actuator_force": (self.model.nu,), "qfrc_bias": (self.model.nv,)}
        shape = blank.get(name, (self.model.nbody, 6 if name == "cvel" else 3))
        return data.seen[name] if name in data.seen else jnp.zeros(shape, data.qpos.dtype)

    def inertia(self, data: Any, dof: int) -> jax.Array:
        return jnp.asarray(free_inertia(self.model, data.seen["qLD"], dof))


class MJXPhysics:
    """MuJoCo in JAX, on any accelerator.

    Raises:
        ValueError: the model uses something that MJX leaves out.
    """

    def __init__(self, machine: Machine) -> None:
        # MJX takes seconds to import
        from envs._mjx import mjx
        from envs.mjx_engine import check_computed

        check_computed(machine.model)
        model = copy.copy(machine.model)
        for dof in machine.dry_dofs():
            # MJX decides once which joints have dry friction; a trace of it keeps the row
            model.dof_frictionloss[dof] = max(float(model.dof_frictionloss[dof]), 1e-9)
        self.model, self._dry = model, bool(machine.dry_dofs())
        self.mjx_model = mjx.put_model(model)

    def start(self, qpos: jax.Array, qvel: jax.Array) -> Any:
        from envs._mjx import mjx, without_lapack

        data = mjx.make_data(self.model).replace(qpos=qpos, qvel=qvel)
        with jax.numpy_rank_promotion("allow"), without_lapack():
            return mjx.forward(self.mjx_model, data)

    def step(self, data: Any, applied: Applied) -> Any:
        from envs._mjx import mjx, without_lapack

        model, kind = self.mjx_model, data.qpos.dtype
        if self._dry:
            model = model.replace(dof_frictionloss=applied.dry.astype(model.dof_frictionloss.dtype))
        data = data.replace(
            ctrl=applied.ctrl.astype(kind), qfrc_applied=applied.qfrc.astype(kind),
            xfrc_applied=applied.xfrc.astype(kind),
        )  # fmt: skip
        with jax.numpy_rank_promotion("allow"), without_lapack():  # MJX relies on the first
            return mjx.step(model, data)

    def read(self, data: Any, name: str) -> jax.Array:
        return getattr(data, name)

    def inertia(self, data: Any, dof: int) -> jax.Array:
        from envs._mjx import mjx

        unit = jnp.zeros(self.model.nv, data.qpos.dtype).at[dof].set(1.0)
        return 1.0 / jnp.linalg.solve(mjx.full_m(self.mjx_model, data), unit)[dof]


def physics_of(machine: Machine, backend: str = "auto") -> Physics:
    """The physics of a backend: `c`, `mjx`, or `auto` (`c` on a CPU, else `mjx`).

    Raises:
        ValueError: a backend that has none, or a model that MJX cannot simulate.
    """
    if backend == "auto":
        backend = "c" if jax.default_backend() == "cpu" else "mjx"
    if backend not in ("c", "mjx"):
        raise ValueError(f"a corrected machine runs on backend 'c' or 'mjx', not on {backend!r}")
    return CPhysics(machine) if backend == "c" else MJXPhysics(machine)
