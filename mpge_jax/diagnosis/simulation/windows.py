"""Windows: short stretches of recordings that are predicted open loop from an estimated state."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.joint_space import columns_of
from mpge_jax.diagnosis.recordings.noise_level import held_error
from mpge_jax.diagnosis.recordings.recording import Recording, longest_step
from mpge_jax.diagnosis.recordings.states import Noise
from mpge_jax.diagnosis.simulation.actuator_state import activations, settling
from mpge_jax.diagnosis.simulation.drive_signal import Source

Array = np.ndarray
MAX_SAMPLES = 100
"""Rows of a window that are compared, at most."""
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
        keys = (
            "source",
            "start",
            "q0",
            "v0",
            "root",
            "act0",
            "command",
            "times",
            "seen",
            "qpos",
            "qvel",
            "moved",
            "lead",
            "drift",
            "held",
        )
        return replace(self, **{k: getattr(self, k)[index] for k in keys})

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
        times = self.start[:, None] + self.dt * np.arange(-self.history, 0)
        q, v = np.empty((*times.shape, model.nq)), np.empty((*times.shape, model.nv))
        for k, source in enumerate(self.source):
            r = self.sources[source].recording
            after_gaps = r.time[1:][np.diff(r.time) > longest_step(r)]
            begins = np.append(r.time[0], after_gaps[after_gaps <= self.start[k] + 1e-9])
            times[k] = np.maximum(times[k], begins[-1])
            q[k], v[k] = self.sources[source].motion_at(model, times[k])
        return q, v, self.start[:, None] - times

    def _commands(self, grid: Array) -> Array:
        """Mean commands [W, L, nu] between consecutive times `grid` [L + 1] after the starts."""
        return _commands(self.sources, self.source, self.start, grid, self.command.shape[2])


def choose_dt(recordings: list[Recording], timestep: float) -> float:
    """Step that divides the sample time where sampling is uniform, near the model's own timestep."""
    steps = np.concatenate([np.diff(r.time) for r in recordings])
    median = float(np.median(steps))
    uniform = float(np.quantile(np.abs(steps - median), 0.9)) < 0.01 * median
    if median < timestep:
        return max(median, 0.25 * timestep) if uniform else timestep
    if not uniform:
        return timestep
    ratio = median / timestep
    return median / (round(ratio) if abs(ratio - round(ratio)) < 0.02 else np.ceil(ratio))


def roughness(recording: Recording) -> Array:
    """How abruptly the motion changes around each row [T], in units of its median: impacts stand out."""
    q = recording.qpos[:, ~np.isnan(recording.qpos).any(0)]
    out = np.zeros(q.shape[0])
    if q.shape[0] < 12:
        return out
    third = np.abs(np.diff(q, 3, axis=0))
    third = third / np.maximum(np.median(third, axis=0), 1e-12 + 1e-9 * np.abs(q).max(0))
    level = third.max(1)
    for shift in range(-2, 6):
        index = np.clip(np.arange(level.size) + shift, 0, level.size + 2)
        out[index] = np.maximum(out[index], level)
    return out


def _spans(recording: Recording, duration: float, skip: float = 0.0) -> list[tuple[int, int]]:
    """Non-overlapping (first row, last row) of at most `duration` seconds without gaps, after the first `skip` seconds.

    A window does not start at an impact, where no smoother knows the state: it starts at the first calm row.
    """
    t = recording.time
    steps = np.diff(t)
    limit = longest_step(recording)
    rough = roughness(recording)
    calm = max(6.0, 2.0 * float(np.median(rough)))
    out, a = [], int(np.searchsorted(t, t[0] + skip))
    while a < t.size - 1:
        until = max(int(np.searchsorted(t, t[a] + 0.4 * duration)), a + 1)
        below = np.flatnonzero(rough[a:until] <= calm)
        a += int(below[0]) if below.size else int(np.argmin(rough[a:until]))
        b = int(np.searchsorted(t, t[a] + duration * (1 + 1e-6) + 1e-9, side="right")) - 1
        broken = np.flatnonzero(steps[a : max(b, a + 1)] > limit)
        if broken.size:
            a = a + int(broken[0]) + 1
            continue
        if t[b] - t[a] >= 0.8 * duration * (1 - 1e-6):
            out.append((a, b))
            a = b
        else:
            # rows were lost before its end: the next one starts after them
            a = max(b, a + 1)
    return out


def cut(
    sources: tuple[Source, ...],
    model: mujoco.MjModel,
    noise: Noise,
    duration: float,
    limit: int,
    dt: float,
    rng: np.random.Generator,
    max_samples: int = MAX_SAMPLES,
) -> Windows:
    """Cut at most `limit` windows of `duration` seconds with at most `max_samples` rows, spread over all recordings."""
    found = [
        (i, a, b)
        for i, s in enumerate(sources)
        for a, b in _spans(s.recording, duration, max(settling(s, model), s.spent))
    ]
    if len(found) > limit:
        keep = np.sort(rng.permutation(len(found))[:limit])
        found = [found[k] for k in keep]
    steps = max(
        (
            int(np.ceil((sources[i].recording.time[b] - sources[i].recording.time[a]) / dt - 1e-6))
            for i, a, b in found
        ),
        default=1,
    )
    rows = []
    for _, a, b in found:
        inside = np.arange(a + 1, b + 1)
        if inside.size > max_samples:
            inside = inside[np.unique(np.linspace(0, inside.size - 1, max_samples).astype(int))]
        rows.append(inside)
    n, w = max((r.size for r in rows), default=1), len(found)
    before = int(np.ceil(HISTORY / dt))
    nq, nv = model.nq, model.nv
    times, seen = np.zeros((w, n)), np.zeros((w, n), bool)
    qpos, qvel = np.full((w, n, nq), np.nan), np.full((w, n, nv), np.nan)
    drift, held = np.zeros((2, w, n, nv))
    q0, v0, root = np.zeros((w, nq)), np.zeros((w, nv)), np.zeros((w, nv, 2, 2))
    act0 = np.zeros((w, model.na))
    start = np.zeros(w)
    each = {i for i, _, _ in found}
    activation = {i: activations(model, sources[i]) for i in each}
    rounded = {i: _held(sources[i].recording, model, noise) for i in each}
    for k, ((i, a, _), inside) in enumerate(zip(found, rows, strict=True)):
        s = sources[i]
        r = s.recording
        start[k] = r.time[a]
        m = inside.size
        times[k, :m], seen[k, :m] = r.time[inside] - r.time[a], True
        qpos[k, :m] = r.qpos[inside]
        drift[k, :m] = noise.stamp * s.states.qvel[inside]
        held[k, :m] = rounded[i][inside]
        if r.qvel is not None:
            qvel[k, :m] = r.qvel[inside]
        q0[k], v0[k] = s.states.qpos[a], s.states.qvel[a]
        root[k] = factors(s.states.cov[a])
        act0[k] = activation[i][a]
    qvel[:, :, ~np.isfinite(noise.qvel)] = np.nan
    source = np.array([i for i, _, _ in found], dtype=int)
    command = _commands(sources, source, start, dt * np.arange(-before, steps + 1), model.nu)
    return Windows(
        sources, source, start, dt, steps, q0, v0, root, act0, command, times, seen, qpos, qvel,
        np.zeros((w, nv, 2)), np.zeros_like(seen), drift, held,
    )  # fmt: skip


def _held(r: Recording, model: mujoco.MjModel, noise: Noise) -> Array:
    """[T, nv] `held_error` of a recording's positions."""
    out = np.zeros((r.time.size, model.nv))
    columns, dofs, _ = columns_of(model)
    for column, dof in zip(columns, dofs, strict=True):
        out[:, dof] = held_error(r.qpos[:, column], float(noise.quantum[column]), float(noise.qpos[column]))
    return out


def _commands(sources: tuple[Source, ...], source: Array, start: Array, grid: Array, nu: int) -> Array:
    """Mean commands [W, L, nu] between consecutive times `grid` [L + 1] after starts [W] in sources [W]."""
    out = np.zeros((source.size, grid.size - 1, nu))
    for s in np.unique(source):
        of = source == s
        out[of] = sources[s].mean_command(start[of, None] + grid)
    return out


def factors(cov: Array) -> Array:
    """Lower factors [nv, 2, 2] of 2 x 2 covariances, tolerant of singular ones."""
    a = np.sqrt(np.maximum(cov[:, 0, 0], 1e-18))
    b = cov[:, 1, 0] / a
    c = np.sqrt(np.maximum(cov[:, 1, 1] - b**2, 1e-4 * np.abs(cov[:, 1, 1]) + 1e-18))
    out = np.zeros_like(cov)
    out[:, 0, 0], out[:, 1, 0], out[:, 1, 1] = a, b, c
    return out
