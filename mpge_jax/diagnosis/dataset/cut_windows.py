"""Recordings cut into windows."""

from __future__ import annotations

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.joint_space import columns_of
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.recordings.noise_level import held_error
from mpge_jax.diagnosis.recordings.recording import Recording, longest_step
from mpge_jax.diagnosis.simulation.driving.actuator_state import activations, settling
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.windows import HISTORY, Windows, mean_commands

Array = np.ndarray
MAX_SAMPLES = 100
"""Rows of a window that are compared, at most."""
Stretch = tuple[int, int, int]
"""Number of a source, its first row and its last one."""


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


def _roughness(recording: Recording) -> Array:
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
    rough = _roughness(recording)
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
    """At most `limit` windows of `duration` seconds with at most `max_samples` rows, spread over all recordings."""
    found: list[Stretch] = [
        (i, a, b)
        for i, s in enumerate(sources)
        for a, b in _spans(s.recording, duration, max(settling(s, model), s.spent))
    ]
    if len(found) > limit:
        found = [found[k] for k in np.sort(rng.permutation(len(found))[:limit])]
    lengths = [sources[i].recording.time[b] - sources[i].recording.time[a] for i, a, b in found]
    steps = max((int(np.ceil(x / dt - 1e-6)) for x in lengths), default=1)
    source = np.array([i for i, _, _ in found], dtype=int)
    start = np.array([sources[i].recording.time[a] for i, a, _ in found])
    grid = dt * np.arange(-int(np.ceil(HISTORY / dt)), steps + 1)
    compared = _compared(sources, model, noise, found, start, max_samples)
    return Windows(
        sources=sources,
        source=source,
        start=start,
        dt=dt,
        steps=steps,
        command=mean_commands(sources, source, start, grid, model.nu),
        moved=np.zeros((len(found), model.nv, 2)),
        lead=np.zeros_like(compared["seen"]),
        **_starts(sources, model, found),
        **compared,
    )


def _starts(sources: tuple[Source, ...], model: mujoco.MjModel, found: list[Stretch]) -> dict[str, Array]:
    """Estimated states where windows start, by the names of `Windows`."""
    states = [(sources[i].states, a) for i, a, _ in found]
    activation = {i: activations(model, sources[i]) for i in {i for i, _, _ in found}}

    def stacked(rows: list[Array], *shape: int) -> Array:
        return np.stack(rows) if rows else np.zeros((0, *shape))

    return {
        "q0": stacked([s.qpos[a] for s, a in states], model.nq),
        "v0": stacked([s.qvel[a] for s, a in states], model.nv),
        "root": stacked([factors(s.cov[a]) for s, a in states], model.nv, 2, 2),
        "act0": stacked([activation[i][a] for i, a, _ in found], model.na),
    }


def _compared(
    sources: tuple[Source, ...],
    model: mujoco.MjModel,
    noise: Noise,
    found: list[Stretch],
    start: Array,
    most: int,
) -> dict[str, Array]:
    """The rows of windows that are compared with what is predicted, by the names of `Windows`."""
    rows = [_spread(np.arange(a + 1, b + 1), most) for _, a, b in found]
    shape = len(found), max((r.size for r in rows), default=1)
    times, seen = np.zeros(shape), np.zeros(shape, bool)
    qpos, qvel = np.full((*shape, model.nq), np.nan), np.full((*shape, model.nv), np.nan)
    drift, held = np.zeros((2, *shape, model.nv))
    rounded = {i: _held(sources[i].recording, model, noise) for i in {i for i, _, _ in found}}
    for k, ((i, _, _), inside) in enumerate(zip(found, rows, strict=True)):
        s, m = sources[i], inside.size
        times[k, :m], seen[k, :m] = s.recording.time[inside] - start[k], True
        qpos[k, :m] = s.recording.qpos[inside]
        if s.recording.qvel is not None:
            qvel[k, :m] = s.recording.qvel[inside]
        drift[k, :m] = noise.stamp * s.states.qvel[inside]
        held[k, :m] = rounded[i][inside]
    qvel[:, :, ~np.isfinite(noise.qvel)] = np.nan
    return {"times": times, "seen": seen, "qpos": qpos, "qvel": qvel, "drift": drift, "held": held}


def _spread(rows: Array, most: int) -> Array:
    """At most so many of these, spread over all."""
    if rows.size <= most:
        return rows
    return rows[np.unique(np.linspace(0, rows.size - 1, most).astype(int))]


def _held(r: Recording, model: mujoco.MjModel, noise: Noise) -> Array:
    """[T, nv] `held_error` of a recording's positions."""
    out = np.zeros((r.time.size, model.nv))
    columns, dofs, _ = columns_of(model)
    for column, dof in zip(columns, dofs, strict=True):
        out[:, dof] = held_error(r.qpos[:, column], float(noise.quantum[column]), float(noise.qpos[column]))
    return out


def factors(cov: Array) -> Array:
    """Lower factors [nv, 2, 2] of 2 x 2 covariances, tolerant of singular ones."""
    a = np.sqrt(np.maximum(cov[:, 0, 0], 1e-18))
    b = cov[:, 1, 0] / a
    c = np.sqrt(np.maximum(cov[:, 1, 1] - b**2, 1e-4 * np.abs(cov[:, 1, 1]) + 1e-18))
    out = np.zeros_like(cov)
    out[:, 0, 0], out[:, 1, 0], out[:, 1, 1] = a, b, c
    return out
