"""The machine driven by what was found of its drives, where their forces were measured."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared, with_drives
from mpge_jax.diagnosis.drives.command_to_force import ActuatorSide, diagnose_actuators
from mpge_jax.diagnosis.drives.force_noise import freed
from mpge_jax.diagnosis.drives.servo_laws import by_their_laws
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.measurement.encoder_zeros import with_zeros
from mpge_jax.diagnosis.measurement.servo_force_age import aged, describe_age, staleness
from mpge_jax.diagnosis.recordings.states import told_with_commands
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.measured_drives import is_servo

OFFSET = "encoder_offset"


def driven_as_found(p: Prepared, plain: mujoco.MjModel) -> tuple[Prepared, ActuatorSide | None]:
    """The same recordings with measured forces freed of their noise, changing between rows as their drives do, and as
    old as the drives hold them, or with their laws in place of them; and what was found of the drives (None: no force
    was measured)."""
    at_rows = _as_drives_see_it(p, plain)
    drives = diagnose_actuators(at_rows, plain, _ids(p))
    if drives is None:
        return p, None
    p = freed(p, plain, drives)
    p = with_drives(p, plain, *drives.between_rows(plain))
    p = by_their_laws(p, at_rows, plain, drives)
    servos = measured_servos(p, plain)
    age = staleness(p, servos)
    if age:
        p.warnings.append(describe_age(age))
        p = aged(p, servos, age)
    return p, drives


def _as_drives_see_it(p: Prepared, plain: mujoco.MjModel) -> Prepared:
    """The same with the motion as it is at the rows, where servos' measured forces are compared with what they make of
    it: accelerations jump there with the commands."""
    known = any(s.states.jumps is not None for s in p.sources)
    if known or p.noise.direct or not measured_servos(p, plain):
        return p
    recordings = [s.recording for s in p.sources]
    states = told_with_commands(recordings, p.model, p.noise, plain, len(p.looked_at), simulated=False)
    each = iter(states)
    return p.mapped(lambda s: replace(s, states=next(each)))


def measured_servos(p: Prepared, plain: mujoco.MjModel) -> list[int]:
    """Servos that the force measured on them drives."""
    return [a for a in map(int, np.flatnonzero(p.by_force)) if is_servo(plain, a)]


def as_encoders_read(p: Prepared, plain: mujoco.MjModel, drives: ActuatorSide, found: Fitted) -> ActuatorSide:
    """What was found of the drives, looked for again where encoders of joints with servos were found to read otherwise
    than their model has it: taken for the position that a servo acts on, what they read too much is a bias of it."""
    offsets, unsure = np.zeros(p.model.nq), np.zeros(p.model.nv)
    # of one that does as its model says on what is read there is nothing to be told otherwise
    servos = {*measured_servos(p, plain), *(a for a in drives.laws if is_servo(plain, a))}
    joints = {int(plain.actuator_trnid[a, 0]) for a in servos}
    h = found.hypothesis
    for term, part in zip(h.terms, h.slices(p.ctx), strict=True):
        if term.id == OFFSET and term.place.index in joints:
            offsets[p.ctx.qadr(term.place)] = found.theta[part.start]
            unsure[p.ctx.dof(term.place)] = found.cov[part.start, part.start] if found.cov.size else 0.0
    if not offsets.any():
        return drives
    read = with_zeros(p, {s.recording.log: offsets for s in p.sources})
    read = _as_drives_see_it(read, plain).mapped(lambda s: _less_sure(s, unsure))
    return diagnose_actuators(replace(read, warnings=[]), plain, _ids(p)) or drives


def _less_sure(s: Source, variance: np.ndarray) -> Source:
    """A recording whose positions are unknown by more, all alike: by this variance [nv]."""
    cov = s.states.cov.copy()
    cov[:, :, 0, 0] += variance
    return replace(s, states=replace(s.states, cov=cov))


def _ids(p: Prepared) -> list[str]:
    """Effects of actuators to try."""
    tried = p.config.effects
    return [
        i
        for i, e in REGISTRY.items()
        if e.side == "actuator" and (tried is None or i.partition(":")[0] in tried)
    ]
