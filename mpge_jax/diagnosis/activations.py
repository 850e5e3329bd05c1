"""What the model's own filters, muscles and integrators hold when a window starts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

if TYPE_CHECKING:
    from mpge_jax.diagnosis.windows import Source

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
    if source.activation is not None:
        return 0.0
    late = 0.0 if source.late is None else float(np.max(source.late, initial=0.0))
    longest = late + 5.0 * float(time_constants(model).max(initial=0.0))
    return min(longest, UNSETTLED * source.recording.duration)


def activation(model: mujoco.MjModel, source: Source, row: int) -> Array:
    """Activations of the nominal model's own filters at a row, from the commands before it."""
    act, taus = np.zeros(model.na), time_constants(model)
    t, kinds = source.recording.time, model.actuator_dyntype
    for a in range(model.nu):
        adr, tau = int(model.actuator_actadr[a]), float(taus[a])
        if adr < 0 or (tau == 0 and kinds[a] != mujoco.mjtDyn.mjDYN_INTEGRATOR):
            continue
        first = int(np.searchsorted(t, t[row] - 10 * tau)) if tau > 0 else 0
        commands, steps = _reached(source, a, first, row), np.diff(t[first : row + 1])
        known = None if source.activation is None or first else float(source.activation[adr])
        if tau == 0:
            act[adr] = _integrated(model, a, known or 0.0, commands * steps)
            continue
        x = float(source.command[first, a]) if known is None else known
        for u, step in zip(commands, steps, strict=True):
            if kinds[a] == mujoco.mjtDyn.mjDYN_MUSCLE:
                parts = max(int(np.ceil(step / model.opt.timestep)), 1)
                for _ in range(parts):
                    x += step / parts * mujoco.mju_muscleDynamics(u, x, model.actuator_dynprm[a, :3])
            else:
                x = u + (x - u) * np.exp(-step / tau)
        act[adr] = x
    return act


def _integrated(model: mujoco.MjModel, a: int, start: float, changes: Array) -> float:
    """An integrator's activation after changes [L] from its start, inside its limits at every one."""
    if not model.actuator_actlimited[a]:
        return start + float(changes.sum())
    for change in changes:
        start = float(np.clip(start + change, *model.actuator_actrange[a]))
    return start


def _reached(source: Source, a: int, first: int, row: int) -> Array:
    """Mean commands [row - first] that reach actuator `a` between consecutive rows, as late as the model has it."""
    if row <= first:
        return np.zeros(0)
    return source.mean_command(source.recording.time[first : row + 1])[:, a]
