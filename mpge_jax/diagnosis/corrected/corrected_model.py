"""The corrected machine, rebuilt from `effects.json`: in C MuJoCo and in JAX, for policy learning."""

from __future__ import annotations

import copy
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.corrected.mjcf import CORRECTED, NOMINAL
from mpge_jax.diagnosis.effects.base import REGISTRY, find_place
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import compile_variable, free_inertia, load_spec
from mpge_jax.diagnosis.simulation import single_step
from mpge_jax.diagnosis.simulation.single_step import Machine


@dataclass(frozen=True)
class CorrectedModel:
    """A nominal model with effects, ready to be stepped: qpos [nq], qvel [nv] and ctrl [nu] as the model has them."""

    machine: Machine

    @staticmethod
    def build(
        model: str | Path | mujoco.MjSpec | mujoco.MjModel, effects: list[dict[str, Any]]
    ) -> CorrectedModel:
        """Rebuild from the nominal model and the entries of `effects.json`.

        Raises:
            InputError: an effect or its place is unknown, or a parameter is missing.
        """
        compiled = (
            copy.copy(model) if isinstance(model, mujoco.MjModel) else compile_variable(load_spec(model))
        )
        ctx = nominal_context(compiled)
        parts: dict[Term, np.ndarray] = {}
        for entry in effects:
            if not isinstance(entry, dict) or not isinstance(entry.get("parameters"), dict):
                raise InputError(
                    f"effects: {str(entry)[:80]!r} is no effect; give the file that a diagnosis wrote."
                )
            if "file" in entry and entry.get("form") not in REGISTRY:
                raise InputError(
                    f"effects: {entry['id']} is an effect of {entry['file']}; load it first, by "
                    "mpge_jax.diagnosis.load_effects."
                )
            try:
                effect = REGISTRY[str(entry.get("form", entry["id"]))]
                place = find_place(ctx, effect, entry["at"], entry.get("kind"))
                parts[Term(effect.id, place)] = effect.from_report(ctx, place, entry["parameters"])
            except KeyError as error:
                raise InputError(
                    f"effects: {error} is unknown or missing in {entry.get('id', entry)}."
                ) from None
            except (ValueError, TypeError, AttributeError, IndexError) as error:
                said = " ".join(str(error).split())
                raise InputError(f"effects: {str(entry.get('id'))[:80]} cannot be used ({said}).") from None
        h = Hypothesis.of(*parts)
        return CorrectedModel(Machine.build(ctx, h.terms, tuple(parts[t] for t in h.terms)))

    @staticmethod
    def load(model: str | Path | mujoco.MjSpec, effects_json: str | Path) -> CorrectedModel:
        """Rebuild from the nominal model's file and an `effects.json`.

        Raises:
            InputError: a file cannot be read, or the model is the `corrected.xml` beside the table, in which the
                native effects are already.
        """
        path = Path(effects_json)
        effects = _read_table(path)["effects"]
        if isinstance(model, str | Path) and Path(model).resolve() == path.resolve().with_name(CORRECTED):
            raise InputError(
                f"{CORRECTED} holds the native effects already and {path.name} would add them again; give the "
                f"nominal model ({NOMINAL})."
            )
        return CorrectedModel.build(model, effects)

    @staticmethod
    def from_folder(folder: str | Path) -> CorrectedModel:
        """Rebuild from the folder that a diagnosis wrote: the model that `effects.json` names, with all effects.

        Raises:
            InputError: a file cannot be read.
        """
        path = Path(folder) / "effects.json"
        return CorrectedModel.load(path.parent / _read_table(path)["model"], path)

    def c_stepper(self) -> CStepper:
        """The machine in MuJoCo's C engine."""
        return CStepper(self.machine)

    def jax_engine(self, backend: str = "mjx") -> Any:
        """The machine in JAX: pure `init(qpos, qvel)` and `step(data, ctrl, count)`; jit and vmap.

        Args:
            backend: what computes the physics: `mjx` (MuJoCo in JAX), `c` (its C engine), or `auto` (`c` on a CPU).
        """
        from mpge_jax.diagnosis.corrected.jax_engine import CorrectedEngine

        return CorrectedEngine(self.machine, backend)


def _read_table(path: Path) -> dict[str, Any]:
    """An `effects.json`."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(table["effects"], list) or not isinstance(table["model"], str):
            raise KeyError("effects")
    except (OSError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"cannot read {path.name} ({error}); give the file that a diagnosis wrote."
        ) from None
    return dict(table)


class CStepper:
    """Step a corrected machine on one MjData."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.model = copy.copy(machine.model)
        self.data = mujoco.MjData(self.model)
        self._commands: tuple[Any, ...] | None = None
        self._forces: tuple[Any, ...] | None = None
        self._past: list[tuple[float, np.ndarray, np.ndarray]] = []

    def reset(self, qpos: np.ndarray, qvel: np.ndarray, commands: np.ndarray | None = None) -> None:
        """Start in a state; `commands` [n, nu] are those of the last n steps before it, for what acts late."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self.model, self.data)
        self._commands = self._forces = None
        self._past = [(0.0, self.data.qpos.copy(), self.data.qvel.copy())]
        for ctrl in () if commands is None else np.asarray(commands, dtype=float):
            self._reached(ctrl)

    def _reached(self, ctrl: np.ndarray) -> np.ndarray:
        """The command that arrives in a step in which `ctrl` is sent."""
        dt = float(self.model.opt.timestep)
        if self._commands is None:
            self._commands = single_step.command_start(np, self.machine, ctrl, dt)
        reached, self._commands = single_step.command_step(np, self.machine, ctrl, self._commands, dt)
        return reached

    def _body_velocity(self, body: int) -> np.ndarray:
        root = int(self.model.body_rootid[body])
        arm = self.data.xipos[body] - self.data.subtree_com[root]
        return self.data.cvel[body, 3:] + np.cross(self.data.cvel[body, :3], arm)

    def _inertia(self, dof: int) -> np.ndarray:
        return free_inertia(self.model, self.data.qLD, dof)

    def step(self, ctrl: np.ndarray, count: int = 1) -> None:
        """`count` steps under a command [nu] that is held."""
        m, d, dt = self.machine, self.data, float(self.model.opt.timestep)
        ctrl = np.asarray(ctrl, dtype=float)
        for _ in range(count):
            reached = self._reached(ctrl)
            s = single_step.observe(
                np,
                m,
                d.qpos,
                d.qvel,
                reached,
                self._body_velocity,
                d.actuator_force,
                dt,
                d.qfrc_bias,
                self._inertia,
            )
            if self._forces is None:
                self._forces = single_step.force_start(np, m, s)
            applied, self._forces = single_step.force_step(np, m, s, self._forces)
            self.model.dof_frictionloss[:] = applied.dry
            d.qfrc_applied[:], d.xfrc_applied[:] = applied.qfrc, applied.xfrc
            if self.model.nu:
                d.ctrl[:] = applied.ctrl
            mujoco.mj_step(self.model, d)
            self._past.append((float(d.time), d.qpos.copy(), d.qvel.copy()))

    def measured(self) -> np.ndarray:
        """Positions [nq] as the encoders report them (offset and delay included)."""
        out = self.data.qpos.copy()
        for column, (offset, delay) in self.machine.senses().items():
            if delay:
                out[column] = self._before(delay, [q[column] for _, q, _ in self._past])
            out[column] += offset
        return out

    def measured_speed(self) -> np.ndarray:
        """Velocities [nv] as the encoders report them (delay included)."""
        out = self.data.qvel.copy()
        for dof, delay in self.machine.late_speeds().items():
            out[dof] = self._before(delay, [v[dof] for _, _, v in self._past])
        return out

    def _before(self, delay: float, values: list[float]) -> float:
        return float(np.interp(self.data.time - delay, [t for t, _, _ in self._past], values))
