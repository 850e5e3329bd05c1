"""A recording: measured motion, commands and forces over time, checked against the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.model import Names, is_scalar, qpos_columns, weighed_by_torque

Array = np.ndarray
WRAP = 1.6 * np.pi
"""Least jump (rad) of an angle from one row to the next that is taken for a full turn, where all others are far
smaller."""
EPOCH = 1e8
"""Seconds from which on a clock is one that counts from 1970, and tells people nothing."""
LARGEST = 1e9
"""Positions, velocities, commands or forces beyond which a number is no measurement."""
SLOWEST = 1.0
"""Typical seconds between rows above which a clock is not in seconds, or nothing is seen of the motion."""


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


def _column_name(model: mujoco.MjModel, names: Names, key: str, column: int) -> str:
    if key == "qpos":
        for j in range(model.njnt):
            start, end = qpos_columns(model, j)
            if start <= column < end:
                return names.joints[j]
    if key == "qvel":
        return names.joint_of_dof(model, column)
    return names.actuators[column]


def row_from_zero(row: int) -> str:
    """How a row of an array is called."""
    return f"row {row}"


def validate(
    recording: Recording, model: mujoco.MjModel, names: Names, called: Callable[[int], str] = row_from_zero
) -> Recording:
    """Check a recording against the model; return it with warnings attached.

    Args:
        called: how a row, counted from 0, is called in messages.

    Raises:
        InputError: shapes, order of time, NaN or Inf, or quaternions are wrong.
    """
    recording = _of_arrays(recording)
    name, time = recording.name, recording.time
    if time.ndim != 1 or time.size < 2:
        raise InputError(f"{name}: 'time' must be a column of at least two rows, got shape {time.shape}.")
    if not np.isfinite(time).all():
        row = int(np.flatnonzero(~np.isfinite(time))[0])
        raise InputError(f"{name}: 'time' is not finite at {called(row)}; remove or repair that row.")
    steps = np.diff(time)
    if (steps <= 0).any():
        row = int(np.flatnonzero(steps <= 0)[0]) + 1
        word = "repeats" if steps[row - 1] == 0 else "runs backwards"
        raise InputError(
            f"{name}: time {word} at {called(row)}, {time[row - 1] - time[0]:.4g} s after the first row"
            f"{'' if steps[row - 1] == 0 else f', by {-steps[row - 1]:.3g} s'}; sort the rows and drop duplicates."
        )
    if (typical := float(np.median(steps))) > SLOWEST:
        raise InputError(
            f"{name}: rows are {typical:.3g} s apart, too far to tell how it moved; times are in seconds "
            "(a map converts others)."
        )
    widths = {"qpos": model.nq, "qvel": model.nv, "ctrl": model.nu, "force": model.nu}
    for key, width in widths.items():
        value = getattr(recording, key)
        shown = "actuator_force" if key == "force" else key
        if value is None:
            continue
        if value.ndim != 2 or len(value) != time.size:
            raise InputError(
                f"{name}: '{shown}' has shape {value.shape}, but 'time' has {time.size} rows; both need the same."
            )
        if value.shape[1] != width:
            parts = names.actuators if key in ("ctrl", "force") else names.joints
            raise InputError(
                f"{name}: '{shown}' has {value.shape[1]} columns but the model needs {width} "
                f"({', '.join(parts)[:200]}); check that model and recording belong together."
            )
        _check_finite(name, shown, value, model, names, called, holes=key == "force")
    if recording.ctrl is None and recording.force is None and model.nu:
        raise InputError(
            f"{name}: there are neither commands ('ctrl') nor measured forces ('actuator_force'); record at "
            "least one of them."
        )
    if recording.ctrl is None and recording.force is not None:
        for a in np.flatnonzero(np.isnan(recording.force).all(axis=0)):
            raise InputError(
                f"{name}: nothing tells what {names.actuators[a]} did: there are no commands ('ctrl') and its "
                "'actuator_force' is NaN throughout; record one of the two."
            )
    notes = list(_warnings(recording, model, names))
    return replace(_unit_quaternions(recording, model, called), warnings=(*recording.warnings, *notes))


def _of_arrays(r: Recording) -> Recording:
    """The recording with arrays in place of lists, and without commands or forces of which there is none."""
    qvel, ctrl, force = (None if x is None else np.asarray(x) for x in (r.qvel, r.ctrl, r.force))
    ctrl, force = (None if x is None or (x.size and np.isnan(x).all()) else x for x in (ctrl, force))
    return replace(r, time=np.asarray(r.time), qpos=np.asarray(r.qpos), qvel=qvel, ctrl=ctrl, force=force)


def _check_finite(
    name: str,
    key: str,
    value: Array,
    model: mujoco.MjModel,
    names: Names,
    called: Callable[[int], str],
    *,
    holes: bool,
) -> None:
    """NaN is allowed in a whole column (never measured), elsewhere only in forces; what no machine does never is."""
    absurd = np.abs(value) > LARGEST
    if absurd.any():
        row, column = (int(x[0]) for x in np.nonzero(absurd))
        where, number = _column_name(model, names, key, column), value[row, column]
        what = "infinite" if np.isinf(number) else f"{number:.3g}, which no machine does,"
        raise InputError(f"{name}: '{key}' of {where} is {what} at {called(row)}; remove or repair that row.")
    missing = np.isnan(value)
    whole = missing.all(axis=0)
    if key == "ctrl" and missing.any():
        row, column = (int(x[0]) for x in np.nonzero(missing))
        what = "was not recorded" if whole[column] else f"is NaN at {called(row)}"
        raise InputError(f"{name}: 'ctrl' of {names.actuators[column]} {what}; every command must be known.")
    if key == "qpos" and whole.all():
        raise InputError(f"{name}: no position was measured at all ('qpos' is all NaN).")
    partly = missing & ~whole
    if partly.any() and not holes:
        row, column = (int(x[0]) for x in np.nonzero(partly))
        where = _column_name(model, names, key, column)
        raise InputError(
            f"{name}: '{key}' of {where} is NaN at {called(row)}; drop such rows, or make the whole column NaN if "
            "it was never measured."
        )


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


def _unit_quaternions(recording: Recording, model: mujoco.MjModel, called: Callable[[int], str]) -> Recording:
    columns = quaternion_columns(model)
    if not columns:
        return recording
    qpos = recording.qpos.copy()
    for joint, start in columns:
        quat = qpos[:, start : start + 4]
        if np.isnan(quat).all():
            continue
        norm = np.linalg.norm(quat, axis=1)
        if (np.abs(norm - 1) > 0.05).any() or np.isnan(norm).any():
            row = int(np.flatnonzero(~(np.abs(norm - 1) <= 0.05))[0])
            raise InputError(
                f"{recording.name}: the quaternion of joint {joint} has length {norm[row]:.3g} at {called(row)}, "
                "not 1; the order is w x y z."
            )
        quat = quat / norm[:, None]
        flip = np.cumprod(np.where((quat[1:] * quat[:-1]).sum(1) < 0, -1.0, 1.0))
        quat[1:] *= flip[:, None]
        qpos[:, start : start + 4] = quat
    return replace(recording, qpos=qpos)


def unwrapped(recording: Recording, model: mujoco.MjModel, names: Names) -> Recording:
    """The recording without the full turns by which the angles of unlimited hinges jump where an encoder wraps.

    Where velocities were recorded, they tell how far it went from row to row.
    """
    qpos, notes = recording.qpos.copy(), []
    for j in range(model.njnt):
        column = int(model.jnt_qposadr[j])
        value, v = qpos[:, column], np.full(recording.time.size, np.nan)
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE or model.jnt_limited[j] or np.isnan(value).any():
            continue
        if np.ptp(value) > 2.01 * np.pi:
            continue
        if recording.qvel is not None:
            v = recording.qvel[:, model.jnt_dofadr[j]]
        steps = np.diff(value)
        if np.isfinite(v).all():
            dt = np.diff(recording.time)
            turns = np.round((0.5 * (v[1:] + v[:-1]) * dt - steps) / (2 * np.pi))
            # what it did in a gap nobody knows, if it was fast
            far = np.maximum(np.abs(v[1:]), np.abs(v[:-1])) * dt > np.pi
            turns[(dt > longest_step(recording)) & far] = 0
        else:
            jumps = np.abs(steps) > WRAP
            rest = np.abs(steps[~jumps])
            turns = -np.sign(steps) * jumps
            if not rest.size or rest.max() > WRAP / 3:
                continue
        if turns.any():
            qpos[1:, column] += 2 * np.pi * np.cumsum(turns)
            notes.append(
                f"{recording.name}: the angle of {names.joints[j]} wraps at a full turn; it was made continuous."
            )
    return replace(recording, qpos=qpos, warnings=(*recording.warnings, *notes)) if notes else recording


def _warnings(recording: Recording, model: mujoco.MjModel, names: Names) -> list[str]:
    out, name = [], recording.name
    steps = np.diff(recording.time)
    median = float(np.median(steps))
    if steps.max() > longest_step(recording):
        out.append(f"{name}: a gap of {steps.max():.3g} s in time; no window spans it.")
    if median > 0.1:
        out.append(f"{name}: only {1 / median:.3g} rows a second; fast effects cannot be seen.")
    if median < 0.2 * model.opt.timestep:
        out.append(f"{name}: rows are {median:.3g} s apart, closer than the model's timestep.")
    still = []
    for j in range(model.njnt):
        column = int(model.jnt_qposadr[j])
        if not is_scalar(model, j):
            continue
        value = recording.qpos[:, column]
        if np.isnan(value).all():
            continue
        if recording.time.size > 5 and np.ptp(value) == 0:
            still.append(names.joints[j])
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE and np.abs(value).max() > 4 * np.pi:
            limit = np.abs(model.jnt_range[j]).max() if model.jnt_limited[j] else np.inf
            if np.abs(value).max() > 8 * limit or _swings_far(model, j, value):
                out.append(f"{name}: positions of {names.joints[j]} look like degrees; radians are needed.")
    if still:
        out.append(f"{name}: {', '.join(still)} never moved; what acts there cannot be seen here.")
    if recording.ctrl is not None:
        limited = model.actuator_ctrllimited.astype(bool)
        low, high = model.actuator_ctrlrange[:, 0], model.actuator_ctrlrange[:, 1]
        beyond = ((recording.ctrl < low - 1e-9) | (recording.ctrl > high + 1e-9)).any(0) & limited
        for a in np.flatnonzero(beyond):
            out.append(f"{name}: commands of {names.actuators[a]} leave its ctrlrange and are clipped.")
    return out


def _swings_far(model: mujoco.MjModel, joint: int, value: np.ndarray) -> bool:
    """Whether a joint goes many turns there and back, as hardly any but a wheel does, which turns on. Where motors
    alone drive it, `check_units` tells the unit by their torque."""
    free = not model.jnt_limited[joint] and not weighed_by_torque(model, joint)
    return bool(free and np.ptp(value) > 60 and abs(value[-1] - value[0]) < 0.5 * np.ptp(value))


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
