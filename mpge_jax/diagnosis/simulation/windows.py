"""Windows: short stretches of recordings that are predicted open loop from an estimated state."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields, replace
from functools import cached_property

import mujoco
import numpy as np

from mpge_jax.diagnosis.recordings.recording import longest_step
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source

Array = np.ndarray
HISTORY = 0.8
"""Seconds of commands and motion kept before a window, for delays, lags and what stands between motor and link: five
time constants of a slow drive."""


@dataclass(frozen=True)
class Windows:
    """W windows of K steps with N samples each.

    Attributes:
        sources: the recordings. source: [W] index. start: [W] s. dt: step (s). steps: K.
        q0: [W, nq], v0: [W, nv], root: [W, nv, 2, 2] Cholesky factors of the states' covariances.
        act0: [W, na] activations. command: [W, H + K, nu] mean commands, the first H before the start.
        times: [W, N] s after the start. seen: [W, N] whether the sample exists and is compared. lead: [W, N] whether it
            tells where the window starts, and is not compared (`started_from_before`).
        qpos: [W, N, nq]. qvel: [W, N, nv] (NaN where not measured).
        moved: [W, nv, 2] by how much the windows start elsewhere than estimated (`initial_states`), in columns of
            `root`.
        drift: [W, N, nv] by how much the machine moves within the deviation of a time stamp, which may be off by that.
        held: [W, N, nv] deviation of positions for rounding that rows share (`held_error`).
    """

    sources: tuple[Source, ...]
    source: Array
    start: Array
    dt: float
    steps: int
    q0: Array
    v0: Array
    root: Array
    act0: Array
    command: Array
    times: Array
    seen: Array
    qpos: Array
    qvel: Array
    moved: Array
    lead: Array
    drift: Array
    held: Array

    @property
    def shift(self) -> Array:
        """[W, 2 nv] what `moved` is in position and velocity."""
        return np.einsum("wdij,wdj->wid", self.root, self.moved).reshape(self.count, 2 * self.v0.shape[1])

    @cached_property
    def digest(self) -> bytes:
        """What tells a simulation of these windows from one of others of the same sources."""
        digest = hashlib.blake2b(repr((self.dt, self.steps)).encode())
        for x in (self.source, self.start, self.q0, self.v0, self.act0, self.command, self.times, self.seen,
                  self.qpos, self.qvel, self.shift):  # fmt: skip
            digest.update(np.ascontiguousarray(x).tobytes())
        return digest.digest()

    @property
    def recording(self) -> Array:
        """[W] number of the recording: two sources may be parts of one."""
        logs = [s.recording.log for s in self.sources]
        return np.unique(logs, return_inverse=True)[1][self.source]

    @property
    def count(self) -> int:
        return int(self.source.size)

    @property
    def history(self) -> int:
        return self.command.shape[1] - self.steps

    def take(self, index: Array) -> Windows:
        """Some of the windows."""
        each = [f.name for f in fields(self) if f.name not in ("sources", "dt", "steps")]
        return replace(self, **{k: getattr(self, k)[index] for k in each})

    def refined(self, factor: int) -> Windows:
        """The same windows with `factor` times as many steps."""
        return self._stepped(self.dt / factor, self.steps * factor)

    def in_larger_steps(self, factor: int) -> Windows:
        """The same windows with steps `factor` times as long, under the mean commands of those."""
        return self._stepped(self.dt * factor, -(-self.steps // factor))

    def _stepped(self, dt: float, steps: int) -> Windows:
        grid = dt * np.arange(-int(np.ceil(HISTORY / dt)), steps + 1)
        return replace(self, dt=dt, steps=steps, command=self._commands(grid))

    def leading(self) -> Windows:
        """The rows that tell where the windows start, to be compared."""
        rows = int(np.flatnonzero(self.lead.any(0)).max(initial=0)) + 1
        steps = min(self.steps, int(np.ceil(np.where(self.lead, self.times, 0.0).max() / self.dt - 1e-6)) + 1)
        lead = self.lead[:, :rows]
        return replace(
            self,
            steps=steps,
            command=self.command[:, : self.history + steps],
            times=self.times[:, :rows],
            seen=lead,
            qpos=self.qpos[:, :rows],
            qvel=self.qvel[:, :rows],
            lead=np.zeros_like(lead),
            drift=self.drift[:, :rows],
            held=self.held[:, :rows],
        )

    def later(self, seconds: float) -> Windows:
        """The same windows with commands that act later."""
        grid = self.dt * np.arange(-self.history, self.steps + 1) - seconds
        return replace(self, command=self._commands(grid))

    def commanded_before(self, a: int) -> Windows | None:
        """The same windows with commands of actuator `a` from before their recordings that are nearer to its mean
        or beyond it, by as much as its commands spread (the first one may be as large as it can be); None where no
        window's history reaches so far back."""
        grid = self.dt * np.arange(-self.history, self.steps)
        begin = np.array([self.sources[s].recording.time[0] for s in self.source])
        before = self.start[:, None] + grid < begin[:, None] - 1e-9
        if not before.any():
            return None
        given = np.concatenate([s.command[:, a] for s in self.sources])
        command = self.command.copy()
        step = np.where(command[:, :, a] > given.mean(), -given.std(), given.std())
        command[:, :, a] += np.where(before, step, 0.0)
        return replace(self, command=command)

    def older(self, factor: float) -> Windows | None:
        """The same windows with servos' forces `factor` times as old; None where none has an age."""
        if not any(s.age.any() for s in self.sources):
            return None
        return self.driven_by(tuple(s.older(factor) for s in self.sources))

    def otherwise(self) -> list[Windows]:
        """The same with each of the motions that guided joints may have had as well."""
        each = zip(*(s.otherwise for s in self.sources), strict=True)
        return [
            replace(self, sources=tuple(replace(s, states=x) for s, x in zip(self.sources, its, strict=True)))
            for its in each
        ]

    def driven_by(self, sources: tuple[Source, ...]) -> Windows:
        """The same windows of the same recordings with other commands."""
        w = replace(self, sources=sources)
        return replace(w, command=w._commands(self.dt * np.arange(-self.history, self.steps + 1)))

    def before(self, model: mujoco.MjModel) -> tuple[Array, Array, Array]:
        """How the machine came to the starts.

        Returns:
            Its estimated positions [W, H, nq] and velocities [W, H, nv] at the steps before each start, and how long
            (s) ago that was [W, H]: what lies before the recording, or before a gap in it, is as at the first row
            after that.
        """
        times = self.start[:, None] + np.maximum(self.dt * np.arange(-self.history, 0), -self.past[:, None])
        q, v = np.empty((*times.shape, model.nq)), np.empty((*times.shape, model.nv))
        for k, source in enumerate(self.source):
            q[k], v[k] = self.sources[source].motion_at(model, times[k])
        return q, v, self.start[:, None] - times

    @property
    def past(self) -> Array:
        """Seconds [W] that were recorded before each start, without a gap."""
        begins = {}
        for i in set(self.source.tolist()):
            r = self.sources[i].recording
            begins[i] = np.append(r.time[0], r.time[1:][np.diff(r.time) > longest_step(r)])
        pairs = zip(self.source.tolist(), self.start, strict=True)
        return np.array([t - begins[i][begins[i] <= t + 1e-9][-1] for i, t in pairs])

    def _commands(self, grid: Array) -> Array:
        """Mean commands [W, L, nu] between consecutive times `grid` [L + 1] after the starts."""
        return mean_commands(self.sources, self.source, self.start, grid, self.command.shape[2])


def mean_commands(sources: tuple[Source, ...], source: Array, start: Array, grid: Array, nu: int) -> Array:
    """Mean commands [W, L, nu] between consecutive times `grid` [L + 1] after starts [W] in sources [W]."""
    out = np.zeros((source.size, grid.size - 1, nu))
    for s in np.unique(source):
        of = source == s
        out[of] = sources[s].mean_command(start[of, None] + grid)
    return out
