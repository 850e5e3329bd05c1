"""What the force of a servo does between two rows of a recording, where nobody measured it.

Its command is held, so the force starts at the row with that row's jump and from there follows the motion. A straight
line to the next row's force misses how it bends: a servo of speed gain kv on an inertia M forgets a jump with the rate
kv / M, and its stiffness kp adds what the joint accelerates. Over h seconds a straight line is off by h^2 / 12 of the
force's second derivative on average, which at 100 Hz is a false damping of some hundredths of kp.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mpge_jax.diagnosis.recordings.recording import Recording, longest_step
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.measured_drives import driving, follows, is_servo, plain_force

Array = np.ndarray


@dataclass(frozen=True)
class Law:
    """How the forces of servos follow command and motion at the rows of one recording.

    Attributes:
        jumps: [T, nu] by how much a force jumps as its command does. slopes: [T, nu, 2] force per length and per speed
            of the actuator; 0 where it is saturated or was not measured, and of plain motors without back-EMF.
    """

    jumps: Array
    slopes: Array


def source_of(r: Recording, states: States, plain: mujoco.MjModel, measured: Array) -> Source:
    """A recording with what drives the machine: commands, or forces where they were measured."""
    command, late = driving(r, plain, measured), np.where(measured, 0.0, plain.actuator_delay)
    held = Source.build(r, states, command, late=late)
    return followed(held, plain, measured & follows(plain), nominal(r, states, plain))


def followed(source: Source, plain: mujoco.MjModel, moving: Array, law: Law) -> Source:
    """The same with the forces of `moving` [nu] actuators following the motion between rows."""
    r, states = source.recording, source.states
    smooth = np.where(moving, source.command - np.cumsum(law.jumps, axis=0), 0.0)
    bend = bends(plain, r, states, smooth, law)
    return Source.build(r, states, source.command, smooth, late=source.late, bend=bend)


def servo_jumps(r: Recording, states: States, plain: mujoco.MjModel) -> Array:
    """[T, nu] by how much a servo's force jumps at each row as its command does.

    Between rows the command is held and the force follows the motion alone, so a straight line from one measured force
    to the next would let the servo know its next command half a row early.
    """
    out = np.zeros((r.time.size, plain.nu))
    if r.ctrl is None:
        return out
    before = np.concatenate([r.ctrl[:1], r.ctrl[:-1]])
    for a in range(plain.nu):
        if is_servo(plain, a):
            now, then = (plain_force(plain, a, u, states.qpos, states.qvel) for u in (r.ctrl, before))
            out[:, a] = now - then
    # a force that was not measured is a straight line between its neighbours
    return np.where(np.isfinite(r.known("force")), out, 0.0)


def nominal(r: Recording, states: States, plain: mujoco.MjModel) -> Law:
    """As the model has it."""
    slopes = np.zeros((r.time.size, plain.nu, 2))
    for a in range(plain.nu):
        if r.ctrl is None or not is_servo(plain, a):
            continue
        slopes[:, a] = plain.actuator_biasprm[a, 1:3]
        if plain.actuator_forcelimited[a]:
            force = plain_force(plain, a, r.ctrl, states.qpos, states.qvel)
            low, high = plain.actuator_forcerange[a]
            slopes[(force <= low) | (force >= high), a] = 0.0
    return Law(servo_jumps(r, states, plain), np.where(np.isfinite(r.known("force"))[..., None], slopes, 0.0))


def bends(model: mujoco.MjModel, r: Recording, states: States, smooth: Array, law: Law) -> Array:
    """Second derivative [T - 1, nu] of the forces between rows.

    F'' = k l'' + d l''', with the actuator's length l, its slopes k and d, and M q''' = sum of the forces' moments'
    rates less the joints' damping. A force that relaxes within a row bends less than that (`_relaxed`).
    smooth: [T, nu] forces without their jumps.
    """
    out = np.zeros((r.time.size - 1, model.nu))
    slopes = np.where((law.slopes[:-1] != 0) & (law.slopes[1:] != 0), law.slopes[:-1], 0.0)
    servos = [a for a in range(model.nu) if slopes[:, a].any() and smooth[:, a].any()]
    if not servos:
        return out
    h = np.diff(r.time)[:, None]
    gear, dofs = model.actuator_gear[servos, 0], model.jnt_dofadr[model.actuator_trnid[servos, 0]]
    moments = np.zeros((len(servos), model.nv))
    moments[np.arange(len(servos)), dofs] = gear
    acceleration = np.diff(states.qvel, axis=0) / h
    push = np.diff(smooth[:, servos], axis=0) / h @ moments - model.dof_damping * acceleration
    jerk, yields, data = np.empty_like(push), np.empty((len(push), len(servos))), mujoco.MjData(model)
    solved = np.empty((len(servos) + 1, model.nv))
    for row in range(len(push)):
        data.qpos[:] = states.qpos[row]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_factorM(model, data)
        mujoco.mj_solveM(model, data, solved, np.concatenate([push[row : row + 1], moments]))
        jerk[row], yields[row] = solved[0], (solved[1:] * moments).sum(1)
    stiffness, damping = slopes[:, servos, 0], slopes[:, servos, 1]
    bend = stiffness * gear * acceleration[:, dofs]
    bend += damping * gear * jerk[:, dofs] * _relaxed(-damping * yields * h)
    out[:, servos] = np.where(h > longest_step(r), 0.0, bend)
    return np.nan_to_num(out)


def _relaxed(x: Array) -> Array:
    """By how much a force that relaxes by exp(-x) within a row is off a straight line on average, over what its
    curvature at the middle says."""
    x = np.maximum(x, 1e-3)
    return (0.5 / np.tanh(0.5 * x) - 1.0 / x) * 12.0 / x
