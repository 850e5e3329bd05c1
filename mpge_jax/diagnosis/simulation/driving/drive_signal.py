"""One recording with what drives the machine in it, ready to be cut into windows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.joint_space import integrate
from mpge_jax.diagnosis.machine.model import is_scalar
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.states import States

Array = np.ndarray


@dataclass(frozen=True)
class Source:
    """One recording with its estimates, ready to be cut.

    Attributes:
        command: [T, nu] what drives the actuators (commands, or measured forces).
        smooth: [T, nu] the part of it that changes between rows and is not held.
        integral: [T, nu] its running integral, for means over steps. ramp, bend: [T - 1, nu] by how much it changes
            between two rows, and its second derivative there.
        age: [nu] s by which `smooth` acts late.
        activation: [na] of the actuators' filters at the first row, where it is known.
        late: [nu] s by which commands act late in the model itself.
        otherwise: what the states may have been as well, where some joints are `guided` by them.
    """

    recording: Recording
    states: States
    command: Array
    smooth: Array
    integral: Array
    ramp: Array
    bend: Array
    age: Array
    activation: Array | None = None
    late: Array | None = None
    otherwise: tuple[States, ...] = ()

    @property
    def spent(self) -> float:
        """Seconds at the beginning that no window may show."""
        return self.recording.before

    @staticmethod
    def build(
        recording: Recording,
        states: States,
        command: Array,
        smooth: Array | None = None,
        age: Array | None = None,
        activation: Array | None = None,
        late: Array | None = None,
        bend: Array | None = None,
    ) -> Source:
        """`smooth` [T, nu]: the part of the command that changes between rows (all of a servo's measured force) and
        is not held; it acts `age` [nu] (s) late, and bends there (see `between_rows.bends`)."""
        smooth = np.zeros_like(command) if smooth is None else smooth
        t, aged = recording.time, smooth.copy()
        age = np.zeros(command.shape[1]) if age is None else age
        h = np.diff(t)[:, None]
        bend = np.zeros((h.size, command.shape[1])) if bend is None else bend
        for a in np.flatnonzero(age):
            i, s = _within(t, t - age[a])
            aged[:, a] = smooth[i, a] + s * (smooth[i + 1, a] - smooth[i, a])
            aged[:, a] -= 0.5 * h[i, 0] ** 2 * s * (1 - s) * bend[i, a]
        ramp = np.diff(aged, axis=0)
        mean = (command - smooth + aged)[:-1] + 0.5 * ramp - h**2 / 12 * bend
        integral = np.concatenate([np.zeros((1, command.shape[1])), np.cumsum(h * mean, 0)])
        return Source(recording, states, command, smooth, integral, ramp, bend, age, activation, late)

    def older(self, factor: float) -> Source:
        """The same with `age` times `factor`."""
        return self.rebuilt(age=factor * self.age)

    def rebuilt(self, **changes: Any) -> Source:
        """The same with other arguments of `build`, and what follows from them."""
        names = ("recording", "states", "command", "smooth", "age", "activation", "late", "bend")
        built = Source.build(**{**{name: getattr(self, name) for name in names}, **changes})
        return replace(built, otherwise=self.otherwise)

    def shaken(self, deviation: Array, rng: np.random.Generator) -> Source:
        """The same with noise of a deviation [nu] in every row."""
        noise = deviation * rng.standard_normal(self.command.shape)
        smooth = self.smooth + np.where(self.smooth.any(0), noise, 0.0)
        return self.rebuilt(command=self.command + noise, smooth=smooth)

    def mean_command(self, edges: Array) -> Array:
        """Mean commands [..., L, nu] over the steps between consecutive times `edges` [..., L + 1]."""
        t, steps = self.recording.time, np.diff(edges)
        out = np.empty((*steps.shape, self.command.shape[1]))
        for a in range(self.command.shape[1]):
            sent = edges if self.late is None else edges - self.late[a]
            value = self._integral_at(sent, a)
            value += np.minimum(sent - t[0], 0.0) * self.command[0, a]
            value += np.maximum(sent - t[-1], 0.0) * self.command[-1, a]
            out[..., a] = np.diff(value) / steps
        return out

    def _integral_at(self, times: Array, a: int) -> Array:
        """Integral of one command up to any times (as at the ends before and after the recording)."""
        t = self.recording.time
        value = np.interp(times, t, self.integral[:, a])
        if self.ramp[:, a].any() or self.bend[:, a].any():
            i, s = _within(t, times)
            h = t[i + 1] - t[i]
            value -= 0.5 * h * self.ramp[i, a] * s * (1 - s)
            value += h**3 / 12 * self.bend[i, a] * s * (1 - s) * (1 - 2 * s)
        return value

    def motion_at(self, model: mujoco.MjModel, times: Array) -> tuple[Array, Array]:
        """Smoothed positions [L, nq] and velocities [L, nv] of the whole machine at times [L]."""
        i, s = _within(self.recording.time, times)
        since = (times - self.recording.time[i])[:, None]
        v = self.states.qvel[i] + s[:, None] * (self.states.qvel[i + 1] - self.states.qvel[i])
        q = integrate(model, self.states.qpos[i], 0.5 * since * (self.states.qvel[i] + v))
        for j in filter(partial(is_scalar, model), range(model.njnt)):
            qadr, dof = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])
            q[:, qadr], v[:, dof] = self.state_at(times, qadr, dof)
        return q, v

    def state_at(self, times: Array, qadr: int, dof: int) -> tuple[Array, Array]:
        """Smoothed position and velocity of one scalar joint at any times (cubic Hermite)."""
        t = self.recording.time
        i = np.clip(np.searchsorted(t, times, side="right") - 1, 0, t.size - 2)
        h = t[i + 1] - t[i]
        s = np.clip((times - t[i]) / h, 0.0, 1.5)
        q, v = self.states.qpos[:, qadr], self.states.qvel[:, dof]
        return hermite(s, h, q[i], q[i + 1], v[i], v[i + 1]), v[i] + s * (v[i + 1] - v[i])


def _within(t: Array, times: Array) -> tuple[Array, Array]:
    """The interval of t [T] in which each of `times` lies, and where in it (0 to 1)."""
    i = np.clip(np.searchsorted(t, times, side="right") - 1, 0, t.size - 2)
    return i, np.clip((times - t[i]) / (t[i + 1] - t[i]), 0.0, 1.0)


def hermite(s: Array, h: Array | float, q0: Array, q1: Array, v0: Array, v1: Array) -> Array:
    """Cubic with values q0, q1 and slopes v0, v1 at the ends of an interval of length h; s in [0, 1]."""
    s2, s3 = s * s, s * s * s
    return (
        (2 * s3 - 3 * s2 + 1) * q0 + (s3 - 2 * s2 + s) * h * v0 + (3 * s2 - 2 * s3) * q1 + (s3 - s2) * h * v1
    )
