"""What the model's own filters, muscles and integrators hold when a window starts."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import clipped
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source

Array = np.ndarray
UNSETTLED = 0.2
"""Share of a recording that may be left out because filters still hold what came before it."""


def time_constants(model: mujoco.MjModel) -> Array:
    """Time constants [nu] (s) of the model's own filters and muscles; 0 elsewhere."""
    kind, prm = model.actuator_dyntype, model.actuator_dynprm
    filters = np.isin(kind, (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT)))
    muscles = kind == int(mujoco.mjtDyn.mjDYN_MUSCLE)
    # a muscle's depend on its activation, up to twice its parameters
    return np.where(filters, np.maximum(prm[:, 0], 1e-6), np.where(muscles, 2.0 * prm[:, :2].max(1), 0.0))


def settling(source: Source, model: mujoco.MjModel) -> float:
    """Seconds at the start of a recording in which the actuators' filters and delays still hold what was commanded
    before."""
    longest = 0.0 if source.late is None else float(np.max(source.late, initial=0.0))
    if source.activation is None:
        longest += 5.0 * float(time_constants(model).max(initial=0.0))
    return min(longest, UNSETTLED * source.recording.duration)


def activations(model: mujoco.MjModel, source: Source) -> Array:
    """Activations [T, na] of the nominal model's own filters along a recording, from its commands."""
    t, kinds, taus = source.recording.time, model.actuator_dyntype, time_constants(model)
    out = np.zeros((t.size, model.na))
    if not model.na or t.size < 2:
        return out
    commands, steps = source.mean_command(t), np.diff(t)
    for a in range(model.nu):
        adr = int(model.actuator_actadr[a])
        integrates = kinds[a] == mujoco.mjtDyn.mjDYN_INTEGRATOR
        if adr < 0 or not (integrates or taus[a] > 0):
            continue
        known = None if source.activation is None else float(source.activation[adr])
        # a filter follows its command
        unknown = _began(model, a, source.recording) if integrates else float(source.command[0, a])
        start = unknown if known is None else known
        if integrates:
            out[:, adr] = _integrated(model, a, start, commands[:, a] * steps)
        elif kinds[a] == mujoco.mjtDyn.mjDYN_MUSCLE:
            out[:, adr] = _muscle(model, a, start, commands[:, a], steps)
        else:
            out[:, adr] = _filtered(start, commands[:, a], np.exp(-steps / taus[a]))
    return out


def _began(model: mujoco.MjModel, a: int, recording: Recording) -> float:
    """An integrator's activation at the first row: 0 where the log began, which nobody knows better."""
    past = recording.earlier
    if past is None or past.ctrl is None:
        return 0.0
    changes = clipped(model, past.ctrl)[:-1, a] * np.diff(past.time)
    return float(_integrated(model, a, _began(model, a, past), changes)[-1])


def settled(model: mujoco.MjModel, commands: Array, act: Array) -> Array:
    """Activations [n, na] of filters that have long held the same commands [n, nu]; those `act` [n, na] of others."""
    out, kinds = act.copy(), model.actuator_dyntype
    for a in np.flatnonzero((time_constants(model) > 0) & (kinds != mujoco.mjtDyn.mjDYN_MUSCLE)):
        out[:, int(model.actuator_actadr[a])] = commands[:, a]
    return out


def shifted(model: mujoco.MjModel, a: int, changes: Array, dt: float) -> Array:
    """By how much [n, na] the activation of a filter `a` differs after its last commands differed by `changes` [n, H],
    in steps of `dt`. A muscle's, which is not linear, is left alone."""
    out = np.zeros((len(changes), model.na))
    kind, tau = model.actuator_dyntype[a], time_constants(model)[a]
    if tau > 0 and kind != mujoco.mjtDyn.mjDYN_MUSCLE:
        decay, ago = np.exp(-dt / tau), np.arange(changes.shape[1])[::-1]
        out[:, int(model.actuator_actadr[a])] = changes @ ((1.0 - decay) * decay**ago)
    return out


def _filtered(x: float, commands: Array, decays: Array) -> Array:
    """A first-order filter's states [L + 1] under held commands [L]."""
    out = [x]
    for u, decay in zip(commands.tolist(), decays.tolist(), strict=True):
        x = u + (x - u) * decay
        out.append(x)
    return np.array(out)


def _muscle(model: mujoco.MjModel, a: int, x: float, commands: Array, steps: Array) -> Array:
    """A muscle's activations [L + 1], in steps of the model's length."""
    out = [x]
    for u, step in zip(commands.tolist(), steps.tolist(), strict=True):
        parts = max(int(np.ceil(step / model.opt.timestep)), 1)
        for _ in range(parts):
            x += step / parts * mujoco.mju_muscleDynamics(u, x, model.actuator_dynprm[a, :3])
        out.append(x)
    return np.array(out)


def _integrated(model: mujoco.MjModel, a: int, start: float, changes: Array) -> Array:
    """An integrator's activations [L + 1] after changes [L], inside its limits at every one."""
    if not model.actuator_actlimited[a]:
        return start + np.concatenate([[0.0], np.cumsum(changes)])
    out = [start]
    low, high = model.actuator_actrange[a]
    for change in changes.tolist():
        out.append(min(max(out[-1] + change, low), high))
    return np.array(out)
