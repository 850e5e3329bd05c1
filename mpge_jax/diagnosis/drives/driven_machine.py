"""The machine driven by what was found of its drives, where their forces were measured."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared, with_drives
from mpge_jax.diagnosis.drives.command_to_force import ActuatorSide, diagnose_actuators
from mpge_jax.diagnosis.drives.force_noise import freed
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.measurement.servo_force_age import staleness
from mpge_jax.diagnosis.simulation.measured_drives import is_servo


def driven_as_found(p: Prepared, plain: mujoco.MjModel) -> tuple[Prepared, ActuatorSide | None]:
    """The same recordings with measured forces freed of their noise, changing between rows as their drives do, and as
    old as the drives hold them; and what was found of the drives (None: no force was measured)."""
    tried = p.config.effects
    ids = [
        i
        for i, e in REGISTRY.items()
        if e.side == "actuator" and (tried is None or i.partition(":")[0] in tried)
    ]
    drives = diagnose_actuators(p, plain, ids)
    if drives is None:
        return p, None
    p = freed(p, plain, drives)
    between_rows = drives.between_rows(plain)
    p = with_drives(p, plain, *between_rows)
    servos = [a for a in map(int, np.flatnonzero(p.measured)) if is_servo(plain, a)]
    age = staleness(p, servos)
    if age:
        p.warnings.append(
            f"the servos' measured forces act {1e3 * age:.2g} ms late, as those of servos that compute in steps "
            "and hold their force; this is taken into account and is no missing physics."
        )
        p = with_drives(p, plain, *between_rows, age=dict.fromkeys(servos, age))
    return p, drives
