"""What real logs and real models have beside the physics that is looked for."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from experiments.blind.truth.machine import Machine
from experiments.blind.truth.physics.joint import LAWS
from experiments.blind.vocabulary import DRY_FRICTION, Effect

Array = NDArray[np.float64]
DRIFT = 2e-4  # s a second
SLOW = (1 / 50, 1 / 30, 1 / 15)  # s between rows, commands held as long


@dataclass(frozen=True)
class Circumstances:
    """masses: standard deviation of the factors by which the given model's masses and inertias are off, one a body;
    outliers: share of positions that are read wrong altogether; late_rows: rows by which commands are logged late, of
    all actuators alike; clock: seconds by which the clock of the commands, which drifts, is late at first; law: how dry
    friction sets in; period: between rows [s], None for the machine's own."""

    masses: float = 0.0
    outliers: float = 0.0
    late_rows: int = 0
    clock: float = 0.0
    law: str = "at once"
    period: float | None = None

    def ways(self, effects: Sequence[Effect] = ()) -> list[str]:
        """In words, for the answer; `effects`: the hidden ones."""
        words = []
        if self.masses:
            words.append("masses and inertias off")
        if self.outliers:
            words.append("outliers")
        if self.late_rows:
            words.append("commands logged a row late")
        if self.law != "at once" and any(e.id in DRY_FRICTION for e in effects):
            words.append(f"dry friction {self.law}")
        if self.clock:
            words.append("commands by another clock")
        if self.period is not None:
            words.append(f"rows of {round(1 / self.period)} Hz")
        return words

    def given(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> str:
        """The model as the engine is given it."""
        model = spec.compile()
        factors = np.exp(self.masses * rng.standard_normal((model.nbody, 2)))
        if self.masses:
            for body in spec.bodies[1:]:
                i = model.body(body.name).id
                mass, inertia = factors[i]
                body.explicitinertial = True
                body.mass = float(model.body_mass[i] * mass)
                body.inertia = (model.body_inertia[i] * inertia).tolist()
                body.ipos, body.iquat = model.body_ipos[i].tolist(), model.body_iquat[i].tolist()
        return spec.to_xml()

    def logged(self, columns: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
        """A recording's columns as the log has them."""
        columns = dict(columns)
        if self.late_rows:
            late = np.roll(columns["ctrl"], self.late_rows, axis=0)
            late[: self.late_rows] = columns["ctrl"][0]
            columns["ctrl"] = late
        if self.clock:
            time = columns["time"]
            given = time - self.clock - DRIFT * (time - time[0])
            columns["ctrl"] = columns["ctrl"][np.maximum(np.searchsorted(time, given + 1e-9, "right") - 1, 0)]
        if self.outliers:
            qpos = columns["qpos"].copy()
            wrong = rng.random(qpos.shape) < self.outliers
            qpos[wrong] += (rng.choice([-1.0, 1.0], qpos.shape) * rng.uniform(0.05, 0.5, qpos.shape))[wrong]
            columns["qpos"] = qpos
        return columns


def draw_circumstances(rng: np.random.Generator, machine: Machine, off: bool = True) -> Circumstances:
    """Two of five cases have none, the others one or two of them; a model that is `off` lacks something by that."""
    free = bool((machine.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any())
    kinds = ["masses", "outliers", "late_rows", "period", "clock", "law"]
    count = int(rng.integers(1, 3)) if rng.random() < 0.6 else 0
    wanted = {str(kind) for kind in rng.choice(kinds, count, replace=False)}
    # a quaternion is not read wrong one number at a time, and what balances falls over when it is told late
    held = machine.robot.controller in ("torque", "servo")
    return Circumstances(
        masses=0.03 if "masses" in wanted and off else 0.0,
        outliers=0.002 if "outliers" in wanted and not free else 0.0,
        late_rows=1 if "late_rows" in wanted and machine.model.nu > 1 else 0,
        clock=float(rng.uniform(0.0, 1.5)) * machine.period
        if "clock" in wanted and "late_rows" not in wanted and machine.model.nu > 1
        else 0.0,
        law=str(rng.choice(list(LAWS)[1:])) if "law" in wanted else "at once",
        period=float(rng.choice(SLOW)) if "period" in wanted and held else None,
    )
