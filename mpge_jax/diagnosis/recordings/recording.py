"""A recording: measured motion, commands and forces over time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

Array = np.ndarray
EPOCH = 1e8
"""Seconds from which on a clock is one that counts from 1970, and tells people nothing."""


@dataclass(frozen=True)
class Recording:
    """One log in SI units, rows in time order.

    Attributes:
        name: file name without its ending.
        time: [T] s, strictly increasing.
        qpos: [T, nq] measured positions; a column that was never measured is all NaN.
        qvel: [T, nv] measured velocities or None.
        ctrl: [T, nu] commands, `ctrl[t]` held from `time[t]` to `time[t+1]`, or None.
        force: [T, nu] measured scalar actuator forces (NaN where not measured) or None.
        origin: s to add to `time` for the log's own clock.
        earlier: the same log up to the first row, where that is known.
        part_of: name of the log of which this is a stretch; none of a whole one.
        before: s at its beginning that are not shown, because they belong to another part of the log or told something
            about the rest: they say how what follows began.
        clock_within: s by which commands that came on a clock of their own may all be stamped wrong.
        moved: [T] rows by which the log had each row's command later; None: none.
    """

    name: str
    time: Array
    qpos: Array
    qvel: Array | None = None
    ctrl: Array | None = None
    force: Array | None = None
    warnings: tuple[str, ...] = field(default=(), compare=False)
    origin: float = 0.0
    earlier: Recording | None = field(default=None, compare=False, repr=False)
    part_of: str = ""
    before: float = 0.0
    clock_within: float = 0.0
    moved: Array | None = field(default=None, compare=False, repr=False)

    @property
    def first_shown(self) -> int:
        """The first row that is shown."""
        return int(np.searchsorted(self.time, self.time[0] + self.before - 1e-9))

    @property
    def log(self) -> str:
        """Name of the whole log."""
        return self.part_of or self.name

    def known(self, key: str) -> Array:
        """The array `qvel`, `ctrl` or `force`; NaN throughout where it was not recorded."""
        value = getattr(self, key)
        return np.full((self.time.size, 1), np.nan) if value is None else value

    @property
    def shown_origin(self) -> float:
        """s to add to `time` where people read it: the log's own clock, unless that counts from 1970."""
        return self.origin if abs(self.origin) < EPOCH else 0.0

    @property
    def duration(self) -> float:
        return float(self.time[-1] - self.time[0])


def rows_of(r: Recording, rows: slice, name: str) -> Recording:
    """Some rows of a recording under another name."""

    def cut(value: Array | None) -> Array | None:
        return None if value is None else value[rows]

    first = rows.start or 0
    return replace(
        r,
        earlier=rows_of(r, slice(0, first + 1), name) if first > 0 else r.earlier,
        name=name,
        part_of=r.log,
        before=max(0.0, r.before - float(r.time[first] - r.time[0])),
        time=r.time[rows],
        qpos=r.qpos[rows],
        qvel=cut(r.qvel),
        ctrl=cut(r.ctrl),
        force=cut(r.force),
        moved=cut(r.moved),
    )


def shown(r: Recording) -> Recording:
    """The recording without the rows that are not shown."""
    return rows_of(r, slice(r.first_shown, None), r.name) if r.first_shown else r


def from_zero(r: Recording) -> Recording:
    """The recording with times that begin at 0: those of a clock that began in 1970 resolve a quarter microsecond."""
    return replace(r, time=r.time - r.time[0], origin=r.origin + float(r.time[0]))


def longest_step(recording: Recording) -> float:
    """Seconds between two rows beyond which rows are missing."""
    return max(5 * float(np.median(np.diff(recording.time))), 0.05)


def quaternion_columns(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """(joint, first column) of each quaternion in qpos."""
    out = []
    for j in range(model.njnt):
        kind, start = int(model.jnt_type[j]), int(model.jnt_qposadr[j])
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            out.append((j, start + 3))
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            out.append((j, start))
    return out


def chain_transitions(recordings: list[Recording]) -> list[Recording]:
    """Join two-row recordings (transitions) that follow each other into the episodes that they came from."""
    out: list[Recording] = []
    for r in recordings:
        previous = out[-1] if out else None
        if (
            previous is not None
            and r.time.size == 2
            and "#" in previous.name
            and np.array_equal(previous.qpos[-1], r.qpos[0], equal_nan=True)
            and (r.qvel is None) == (previous.qvel is None)
            and (r.ctrl is None) == (previous.ctrl is None)
            and (r.force is None) == (previous.force is None)
            and (r.qvel is None or np.array_equal(previous.known("qvel")[-1], r.qvel[0], equal_nan=True))
        ):
            out[-1] = _append(previous, r)
        else:
            out.append(replace(r, name=r.name + "#") if r.time.size == 2 else r)
    return [replace(r, name=r.name.removesuffix("#")) for r in out]


def _append(first: Recording, second: Recording) -> Recording:
    # the last command of a transition belongs to no step, so the next transition's first row replaces it
    time = np.concatenate([first.time, [first.time[-1] + second.time[1] - second.time[0]]])

    def join(a: Array | None, b: Array | None) -> Array | None:
        return None if a is None or b is None else np.concatenate([a[:-1], b])

    return replace(
        first,
        time=time,
        qpos=np.concatenate([first.qpos[:-1], second.qpos]),
        qvel=join(first.qvel, second.qvel),
        ctrl=join(first.ctrl, second.ctrl),
        force=join(first.force, second.force),
    )
