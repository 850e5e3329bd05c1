"""A recording cut into the control steps of a task: states one step apart, and the command held between them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.recordings.recording import Recording

Array = np.ndarray
SAME = 0.05
"""Share of a control step by which the rows of a log may be apart otherwise, and still be taken for its steps."""
NOTED = 0.005
"""The same, from which on it is told."""
LOST = 1.5
"""Typical times between rows beyond which rows are missing."""
PHASES = 50
"""Most rows at which the first step of a stretch may begin."""
UNEVEN = 0.02
"""Change of a command within a step, as a share of half its range (rms), from which on it is told."""


@dataclass(frozen=True)
class Steps:
    """R control steps of one recording.

    Attributes:
        qpos, qvel: [R, nq], [R, nv] where each begins. next_qpos, next_qvel: where it ends.
        ctrl: [R, nu] the command, its mean over the step.
        stretch: [R] number of the uninterrupted stretch that a step belongs to.
        notes: what there is to say of them.
    """

    qpos: Array
    qvel: Array
    next_qpos: Array
    next_qvel: Array
    ctrl: Array
    stretch: Array
    notes: tuple[str, ...]


def control_steps(r: Recording, qvel: Array, dt: float, half_range: Array) -> Steps:
    """The control steps in a recording.

    Rows that are one step apart are taken as they are. Where they are closer, states are read at every step, between
    two rows linearly, and steps begin where commands change; one that changes within a step counts by its mean. No step
    spans missing rows.

    Args:
        r: commands included. qvel: [T, nv] velocities at its rows. dt: s of a step.
        half_range: [nu] half the range of each command, by which its changes are judged.

    Raises:
        InputError: rows too far apart.
    """
    assert r.ctrl is not None
    apart = np.diff(r.time)
    typical = float(np.median(apart))
    if typical > (1 + SAME) * dt:
        raise InputError(
            f"{r.name}: its rows are {typical:.4g} s apart and a step of the task lasts {dt:.4g} s, so states from "
            f"step to step are not in it; give the task a longer step (frame_skip), or record {1 / dt:.4g} rows a "
            "second or more."
        )
    whole = abs(typical - dt) <= SAME * dt
    longest = max(LOST * typical, (1 + SAME) * dt)
    edges = np.flatnonzero(apart > longest) + 1
    bounds = np.concatenate([[0], edges, [r.time.size]])
    parts = [
        _whole(r, qvel, int(a), int(b)) if whole else _read_between(r, qvel, int(a), int(b), dt)
        for a, b in itertools.pairwise(bounds)
    ]
    notes = []
    if edges.size:
        notes.append(f"{r.name}: rows are missing in {edges.size} places; no step spans them.")
    if whole and abs(typical - dt) > NOTED * dt:
        notes.append(
            f"{r.name}: its rows are {typical:.4g} s apart and count as steps of {dt:.4g} s, which the simulator takes."
        )
    uneven = (
        np.sqrt(np.mean([x for p in parts for x in p[5]], axis=0)) if any(len(p[5]) for p in parts) else 0.0
    )
    changed = float(np.max(uneven / np.maximum(half_range, 1e-12), initial=0.0))
    if changed > UNEVEN:
        notes.append(
            f"{r.name}: commands change within a step of the task (by {100 * changed:.0f} % of half their range, rms); "
            "their mean over the step counts as the action."
        )
    qpos, speed, next_qpos, next_speed, ctrl = (np.concatenate([p[k] for p in parts]) for k in range(5))
    stretch = np.repeat(np.arange(len(parts)), [len(p[0]) for p in parts])
    return Steps(qpos, speed, next_qpos, next_speed, ctrl, stretch, tuple(notes))


Part = tuple[Array, Array, Array, Array, Array, Array]
"""Fields of `Steps` before `stretch`, and the variance of the command within each step, [R, nu]."""


def _whole(r: Recording, qvel: Array, a: int, b: int) -> Part:
    assert r.ctrl is not None
    now, then = slice(a, b - 1), slice(a + 1, b)
    ctrl = r.ctrl[now]
    return r.qpos[now], qvel[now], r.qpos[then], qvel[then], ctrl, np.zeros_like(ctrl)


def _read_between(r: Recording, qvel: Array, a: int, b: int, dt: float) -> Part:
    """Steps that begin where the log's own commands change, as far as these are held as long."""
    starts = [k for k in range(a, b) if r.time[k] < r.time[a] + (1 - SAME) * dt][:PHASES]
    parts = [_read_from(r, qvel, k, b, dt) for k in starts]
    return min(parts, key=lambda part: float(part[5].mean()) if len(part[5]) else np.inf)


def _read_from(r: Recording, qvel: Array, a: int, b: int, dt: float) -> Part:
    assert r.ctrl is not None
    time = r.time[a:b]
    count = int(np.floor((time[-1] - time[0]) / dt * (1 + 1e-9)))
    at = time[0] + dt * np.arange(count + 1)

    def read(values: Array) -> Array:
        return np.stack([np.interp(at, time, v) for v in values[a:b].T], axis=1).reshape(
            at.size, values.shape[1]
        )

    # The integral of what is held, and of its square, up to every row.
    held = r.ctrl[a : b - 1]
    steps = np.diff(time)[:, None]
    mean, square = (
        np.diff(
            [np.interp(at, time, np.concatenate([[0.0], np.cumsum(x)])) for x in (steps * values).T], axis=1
        ).T.reshape(count, held.shape[1])
        / dt
        for values in (held, held**2)
    )
    qpos, speed = read(r.qpos), read(qvel)
    return qpos[:-1], speed[:-1], qpos[1:], speed[1:], mean, np.maximum(square - mean**2, 0.0)
