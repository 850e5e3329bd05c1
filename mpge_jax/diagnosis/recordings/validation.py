"""Whether a log is one of the model: shapes, times, numbers and what looks wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine.joint_space import columns_of, difference
from mpge_jax.diagnosis.machine.model import Names, is_scalar, qpos_columns, weighed_by_torque
from mpge_jax.diagnosis.recordings.recording import Recording, longest_step, quaternion_columns

Array = np.ndarray
LARGEST = 1e9
"""Positions, velocities, commands or forces beyond which a number is no measurement."""
SINCE_1970 = 1e8
"""Seconds beyond which times are those of a clock that began in 1970."""
SLOWEST = 1.0
"""Typical seconds between rows above which a clock is not in seconds, or nothing is seen of the motion."""
TURNS_LOOKED_AT, UNLIKE, ALIKE = 2000, 0.5, 0.9
"""Rows by which the order of quaternions is told, and the correlation of how these turn with recorded velocities below
which the two are no longer of one motion, and from which on they are."""


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
    if (steps == 0).mean() > 0.5:
        single = "; seconds since 1970 need double precision" if abs(time[0]) > SINCE_1970 else ""
        raise InputError(
            f"{name}: most rows have the time of the row before ({time[0]:.10g} at first){single}; save the time of "
            "every row."
        )
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
    return replace(_unit_quaternions(recording, model, names, called), warnings=(*recording.warnings, *notes))


def _of_arrays(r: Recording) -> Recording:
    """The recording with arrays in place of lists and of single columns, and without commands or forces of which there
    is none."""
    qvel, ctrl, force = (None if x is None else _table(x) for x in (r.qvel, r.ctrl, r.force))
    ctrl, force = (None if x is None or (x.size and np.isnan(x).all()) else x for x in (ctrl, force))
    return replace(r, time=np.asarray(r.time), qpos=_table(r.qpos), qvel=qvel, ctrl=ctrl, force=force)


def _table(value: Array) -> Array:
    value = np.asarray(value)
    return value[:, None] if value.ndim == 1 else value


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


def _column_name(model: mujoco.MjModel, names: Names, key: str, column: int) -> str:
    if key == "qpos":
        for j in range(model.njnt):
            start, end = qpos_columns(model, j)
            if start <= column < end:
                return names.joints[j]
    if key == "qvel":
        return names.joint_of_dof(model, column)
    return names.actuators[column]


def _unit_quaternions(
    recording: Recording, model: mujoco.MjModel, names: Names, called: Callable[[int], str]
) -> Recording:
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
                f"{recording.name}: the quaternion of {names.joints[joint]} has length {norm[row]:.3g} at "
                f"{called(row)}, not 1; the order is w x y z."
            )
        quat = quat / norm[:, None]
        if _real_part_last(recording, model, quat, start):
            raise InputError(
                f"{recording.name}: the quaternion of {names.joints[joint]} turns as its velocities say only if it is "
                "read as x y z w; give it as w x y z."
            )
        flip = np.cumprod(np.where((quat[1:] * quat[:-1]).sum(1) < 0, -1.0, 1.0))
        quat[1:] *= flip[:, None]
        qpos[:, start : start + 4] = quat
    return replace(recording, qpos=qpos)


def _real_part_last(recording: Recording, model: mujoco.MjModel, quat: Array, start: int) -> bool:
    """Whether quaternions [T, 4], in columns from `start` on, turn as the recorded angular velocity does only if their
    last number is taken for the first."""
    dof = dict(columns_of(model)[2])[start]
    if recording.qvel is None or recording.qvel.shape[1] < dof + 3:
        return False
    recorded = recording.qvel[:TURNS_LOOKED_AT, dof : dof + 3]
    if not np.isfinite(recorded).all():
        return False
    between, step = 0.5 * (recorded[1:] + recorded[:-1]), np.diff(recording.time[:TURNS_LOOKED_AT])

    def likeness(as_read: Array) -> float:
        qpos = recording.qpos[:TURNS_LOOKED_AT].copy()
        qpos[:, start : start + 4] = as_read[:TURNS_LOOKED_AT]
        return _likeness(difference(model, qpos[:-1], qpos[1:])[:, dof : dof + 3] / step[:, None], between)

    return likeness(quat) < UNLIKE and likeness(np.roll(quat, 1, axis=1)) > ALIKE


def _likeness(a: Array, b: Array) -> float:
    """Correlation of all numbers of two arrays; 0 where one of them rests."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float((a * b).sum()) / size if size > 0 else 0.0


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
        if look_like_degrees(model, j, value):
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


def look_like_degrees(model: mujoco.MjModel, joint: int, value: np.ndarray) -> bool:
    """Whether a hinge goes farther in radians than its limits or its motors would have it."""
    largest = np.abs(value).max()
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE or not largest > 4 * np.pi:
        return False
    limit = np.abs(model.jnt_range[joint]).max() if model.jnt_limited[joint] else np.inf
    return bool(largest > 8 * limit or _swings_far(model, joint, value))


def _swings_far(model: mujoco.MjModel, joint: int, value: np.ndarray) -> bool:
    """Whether a joint goes many turns there and back, as hardly any but a wheel does, which turns on. Where motors
    alone drive it, `check_units` tells the unit by their torque."""
    free = not model.jnt_limited[joint] and not weighed_by_torque(model, joint)
    return bool(free and np.ptp(value) > 60 and abs(value[-1] - value[0]) < 0.5 * np.ptp(value))
