"""Driven machines asked as those whose motion is given: what the forces of their drives say is missing, all at once.

Where forces were measured, or commands tell them, the motion that they made needs no simulation: nearly every effect is
linear in them, and many at once are found as easily as one.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.given_motion import accelerations_are_known
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.force_balance.procedure import decide
from mpge_jax.diagnosis.machine.model import clipped, has_plain_law, is_joint_transmission
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source

ROWS = 200
"""Rows without which a regression with so many columns says little."""


def forces_are_known(p: Prepared) -> bool:
    """Whether measured forces or commands tell all that acts, along enough rows of motion: not in contacts and loops,
    where joints are not told themselves but guided, or where a drive's command does not tell its force."""
    m = p.model
    known = p.measured | np.array([_tells(m, a) for a in range(m.nu)], bool)
    if not m.nu or not known.all() or p.ctx.contacts or p.sim.guided or m.neq:
        return False
    return sum(s.recording.time.size for s in _along_motion(p)) > ROWS


def _along_motion(p: Prepared) -> tuple[Source, ...]:
    return tuple(s for s in p.train if accelerations_are_known(s.recording, p.model))


def missing_by_forces(p: Prepared) -> Fitted | None:
    """What the training recordings' forces say is missing, where they are known; None where that is nothing. A place to
    start from: what motion forces make was not simulated, and drives may not do as they are told."""
    train = tuple(_told(p, s) for s in _along_motion(p))
    told = replace(
        p, train=train, choice=(), test=(), measured=np.ones(p.model.nu, bool), warnings=list(p.warnings)
    )
    f = decide(told, lambda _text: None).fit
    return replace(f, centre=f.theta) if f.hypothesis.terms else None


def _tells(m: mujoco.MjModel, a: int) -> bool:
    return has_plain_law(m, a) and is_joint_transmission(m, a) and m.actuator_gainprm[a, 0] != 0.0


def _told(p: Prepared, s: Source) -> Source:
    """A recording with what drives give by their model in place of commands, in units of these. Nothing filtered it."""
    m, command = p.model, clipped(p.model, s.command)
    for a in np.flatnonzero(~p.by_force):
        # a command is held from its row to the next, and the motion at a row is that of the intervals around it
        command[1:, a] = 0.5 * (command[1:, a] + command[:-1, a])
        joint, gear = int(m.actuator_trnid[a, 0]), m.actuator_gear[a, 0]
        q = s.states.qpos[:, m.jnt_qposadr[joint]]
        v = s.states.qvel[:, m.jnt_dofadr[joint]]
        if m.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE:
            position, speed = m.actuator_biasprm[a, 1:3]
            command[:, a] += gear * (position * q + speed * v) / m.actuator_gainprm[a, 0]
    force = np.where(p.by_force, s.recording.known("force"), np.nan)
    return s.rebuilt(command=command, recording=replace(s.recording, force=force))
