"""What happens to a command on its way to the drive: it comes late, or smoothed."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

# `scipy.signal` takes longer to import than all of the diagnosis: this way it is where a filter is asked for
import scipy

from mpge_jax.diagnosis.effects.actuator import OfCommand
from mpge_jax.diagnosis.effects.base import register
from mpge_jax.diagnosis.effects.context import Context, Param, Place
from mpge_jax.diagnosis.effects.native import element
from mpge_jax.diagnosis.effects.step import Array

LINEAR = 1
"""Between two commands in the buffer of an actuator's `delay`."""


@register
class ActuatorDelay(OfCommand):
    id, order = "actuator_delay", -2
    equation = "u(t - T)"
    says = "The actuator {at} obeys its command {delay} late."
    tries = (1.0, 3.0, 9.0)
    jagged = True
    confused_with = ("actuator_lag", "joint_flexibility")
    remedy = "a chirp of commands over a wide band, with a second sensor that shows when the response begins"
    max_delay = 0.25

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("delay", "s", 0.0, self.max_delay, 0.5 * max(ctx.period, 2e-3)),)

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        """Half a period off whole ones, where predictions have a kink."""
        return (np.floor(super().starts(ctx, place) / ctx.period + 1e-6) + 0.5) * ctx.period

    def command_memory(self, xp: Any, ctx: Context, place: Place, u: Array, dt: float) -> Any:
        n = int(np.ceil(self.max_delay / dt)) + 2
        return xp.repeat(u[..., None], n, -1)

    def command(self, xp: Any, theta: Array, u: Array, memory: Any, dt: float) -> tuple[Array, Any]:
        # memory[..., i] is the command of i steps ago
        memory = xp.concatenate([u[..., None], memory[..., :-1]], -1)
        lag = xp.minimum(theta[..., 0] / dt, memory.shape[-1] - 2.0)
        whole = xp.floor(lag)
        near = xp.take_along_axis(memory, whole.astype(int)[..., None], -1)[..., 0]
        far = xp.take_along_axis(memory, whole.astype(int)[..., None] + 1, -1)[..., 0]
        part = lag - whole
        return (1 - part) * near + part * far, memory

    def timeline(self, ctx: Context, place: Place, theta: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        lag = (theta[:, 0] / dt)[:, None]
        whole = np.floor(lag).astype(int)
        index = np.arange(u.shape[1])[None] - whole
        near = np.take_along_axis(u, np.maximum(index, 0), 1)
        far = np.take_along_axis(u, np.maximum(index - 1, 0), 1)
        part = lag - whole
        return (1 - part) * near + part * far

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        a = element(spec.actuators, place.index)
        dt = float(ctx.model.opt.timestep)
        if theta[0] < dt:
            return False
        a.delay = float(a.delay + theta[0])
        a.nsample = int(np.ceil(a.delay / dt)) + 1
        a.interp = LINEAR
        return True


@register
class ActuatorLag(OfCommand):
    id, order = "actuator_lag", -1
    equation = "T du_f/dt = u - u_f"
    says = "The actuator {at} follows its command with a time constant of {time_constant}."
    tries = (2.0, 10.0)
    confused_with = ("actuator_delay",)
    remedy = "a chirp of commands over a wide band"

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return (Param("time_constant", "s", 1e-5, 1.0, 0.5 * max(ctx.period, 2e-3)),)

    def command_memory(self, xp: Any, ctx: Context, place: Place, u: Array, dt: float) -> Any:
        return u

    def command(self, xp: Any, theta: Array, u: Array, memory: Any, dt: float) -> tuple[Array, Any]:
        # exact mean over the step of the first-order response to a held command
        T = theta[..., 0]
        decay = xp.exp(-dt / T)
        mean = u + (memory - u) * (1 - decay) * T / dt
        return mean, u + (memory - u) * decay

    def timeline(self, ctx: Context, place: Place, theta: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        T = theta[:, :1]
        return u + (self.sampled(ctx, place, theta, u, dt) - u) * (1 - np.exp(-dt / T)) * T / dt

    def sampled(self, ctx: Context, place: Place, theta: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        decays, which = np.unique(np.exp(-dt / theta[:, 0]), return_inverse=True)
        out = np.empty_like(u)
        for k, decay in enumerate(decays):
            rows = which == k
            out[rows], _ = scipy.signal.lfilter([0.0, 1.0 - decay], [1.0, -decay], u[rows], zi=u[rows, :1])
        return out

    def export(self, spec: Any, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        a = element(spec.actuators, place.index)
        # a filter acts a step late
        if a.dyntype != mujoco.mjtDyn.mjDYN_NONE or theta[0] < float(ctx.model.opt.timestep):
            return False
        states = [x.id for x in spec.actuators if x.dyntype != mujoco.mjtDyn.mjDYN_NONE]
        for key in spec.keys:
            # a keyframe without activations has zeros, which are right where commands are too
            if len(key.ctrl) and len(key.act) == len(states):
                before = sum(i < place.index for i in states)
                key.act = np.insert(np.array(key.act), before, float(key.ctrl[place.index]))
        a.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        prm = np.array(a.dynprm)
        prm[0] = theta[0]
        a.dynprm = prm
        return True
