"""Servos driven by their laws, in place of the forces that were measured on them.

Between rows a servo's force follows the motion, in steps of the servo's own. A force that is read from the rows follows
neither, and what it is off by passes for damping and rotor inertia: a force half a millisecond late, of a servo of
stiffness kp, for 0.0005 kp of damping. Where the law that was found explains the measured forces, it says what the
force is at every moment, and holds the machine as it was held, so that noise and starts die away instead of adding up.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.drives.command_to_force import MOVING, ActuatorSide
from mpge_jax.diagnosis.drives.drive_law import left_open, log_of, predict
from mpge_jax.diagnosis.drives.drive_remainder import outside
from mpge_jax.diagnosis.drives.law_fit import DELAY
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.machine.model import clipped, compile_variable
from mpge_jax.diagnosis.recordings.noise_level import column_noise
from mpge_jax.diagnosis.simulation.batch_simulator import Simulator
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.measured_drives import drive_by_force, is_servo
from mpge_jax.diagnosis.simulation.scales import build_context

Array = np.ndarray


def by_their_laws(p: Prepared, at_rows: Prepared, plain: mujoco.MjModel, found: ActuatorSide) -> Prepared:
    """The machine whose servos do as was found of their laws, where that explains what was measured of them. Late ones
    get their commands by a delay of which forces at rows tell the row only (`delay_within_a_row`).

    Such a servo acts on what the encoder of its joint reads: so its law was found to hold.

    Args:
        at_rows: the same with the motion as it is at the rows. plain: the nominal model. found: what its drives lack.
    """
    unlike = {p.names.actuators.index(at) for entry in found.left for at in entry["at"]}
    unlike |= {a for a, f in found.laws.items() if any(t.name in MOVING for t in f.hypothesis.terms)}
    by_law = np.zeros_like(p.measured)
    for a in map(int, np.flatnonzero(p.measured)):
        servo = is_servo(plain, a) and plain.actuator_gainprm[a, 0] != 0.0
        by_law[a] = servo and a not in unlike and _explained(at_rows, plain, found, a)
    if not by_law.any():
        return p
    spec = drive_by_force(p.spec, p.measured & ~by_law)
    for actuator in spec.actuators:
        if by_law[actuator.id]:
            # what encoders read too much may take commands further than their limits, which `clipped` kept
            actuator.ctrllimited = 0
    model = compile_variable(spec)
    acts_late = np.array([found.delay(a) for a in range(plain.nu)])

    def commanded(s: Source) -> Source:
        command = np.where(by_law, clipped(plain, s.recording.known("ctrl")), s.command)
        smooth, bend = (np.where(by_law, 0.0, x) for x in (s.smooth, s.bend))
        late = np.where(by_law, acts_late, 0.0 if s.late is None else s.late)
        return s.rebuilt(command=command, smooth=smooth, bend=bend, late=late)

    out = p.mapped(commanded)
    ctx = build_context(model, p.names, out.train)
    sim = Simulator(model, ctx, threads=p.config.jobs, on_readings=tuple(np.flatnonzero(by_law)))
    for a, f in found.laws.items():
        if by_law[a]:
            prompt = Hypothesis.of(*(t for t in f.hypothesis.terms if t.name != DELAY))
            sim = sim.beside(prompt, f.of_terms(found.ctx, prompt).theta)
    return replace(out, model=sim.model, ctx=sim.ctx, sim=sim, by_law=by_law)


def _explained(p: Prepared, plain: mujoco.MjModel, found: ActuatorSide, a: int) -> bool:
    """Whether a servo's measured forces lie outside what its law makes of the rows around them by no more than the
    noise in them, and in the states that the law acts on, explains."""
    f = found.laws.get(a, NOTHING)
    logs = [log for s in p.looked_at if (log := log_of(s, found.ctx, a, found.grid, 0)) is not None]
    if not logs:
        return False
    errors = [log.force - predict(plain, found.ctx, f, a, log, found.grid) for log in logs]
    white, _ = column_noise([log.time for log in logs], errors)
    missed = np.concatenate([outside(plain, found.ctx, f, a, log, found.grid) for log in logs])
    noise = np.hypot(np.nan_to_num(white), left_open(plain, a, p.looked_at))
    return bool(np.sqrt(np.mean(missed**2)) < noise)
