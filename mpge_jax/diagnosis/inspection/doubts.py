"""Numbers that look as if they were in another unit, of another joint, or not measured at all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import Names, command_limits
from mpge_jax.diagnosis.recordings.checks import not_radians
from mpge_jax.diagnosis.recordings.formats.tables import Log
from mpge_jax.diagnosis.recordings.joining import Joined, quantity_of
from mpge_jax.diagnosis.recordings.joint_names import joint_columns
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.states import States, estimate
from mpge_jax.diagnosis.recordings.validation import SLOWEST, look_like_degrees

Array = np.ndarray
SLIDE = mujoco.mjtJoint.mjJNT_SLIDE
Doubt = tuple[str, dict[str, str]]
"""What looks wrong, and the units by which a map would put it right: of `qpos:elbow`, of `time`."""
ANGLES = {
    "degrees for radians": 180 / np.pi,
    "revolutions a minute for radians a second": 30 / np.pi,
    "turns for radians": 1 / (2 * np.pi),
}
LENGTHS = {"millimetres for metres": 1e3}
"""What a ratio that should be 1 is when one of two columns is in another unit."""
SPEEDS = {180 / np.pi: ("qvel", "deg/s"), 30 / np.pi: ("qvel", "rpm"), 1e3: ("qvel", "mm/s")}
SPEEDS |= {np.pi / 180: ("qpos", "deg"), 1e-3: ("qpos", "mm")}
"""Which unit it is that makes velocities so many times as large as the slope of the positions."""
NEAR, AGREES = 0.15, 0.9
"""Share by which a ratio may miss a factor, and the correlation from which on it means anything."""
ENOUGH = 10
"""Rows from which on columns are compared."""
BEYOND = 0.1
"""Share of a range by which numbers leave it before it is told."""
LIKE_DEGREES = 6.3
"""Radians (a full turn) beyond which a limited joint hardly goes."""
UNITS_OF_TIME = {"milliseconds": ("ms", 1e-3), "microseconds": ("us", 1e-6), "nanoseconds": ("ns", 1e-9)}


def ratio(a: Array, b: Array) -> float | None:
    """The factor between two columns [T] that go together, or None where they do not."""
    known = np.isfinite(a) & np.isfinite(b)
    a, b = a[known], b[known]
    if a.size < ENOUGH:
        return None
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt((a @ a) * (b @ b)))
    if scale == 0 or abs(a @ b) < AGREES * scale:
        return None
    return float((a @ b) / (b @ b))


def meaning(found: float, slides: bool = False) -> str | None:
    """What a ratio that should be 1 says of the units, if it says anything."""
    if abs(found + 1) < NEAR:
        return "of opposite sign"
    for words, factor in (LENGTHS if slides else ANGLES).items():
        for f in (factor, 1 / factor):
            if abs(abs(found) / f - 1) < NEAR:
                return f"{found:.3g} times as large ({words}?)"
    return None


def doubts(
    log: Log, joined: Joined | None, recording: Recording | None, model: mujoco.MjModel, names: Names
) -> list[Doubt]:
    """What looks wrong in a run; nothing where all looks right."""
    out = list(_clocks(log, recording))
    if joined is None:
        return out
    arrays = dict(joined.data)
    if recording is not None:
        arrays = {"time": recording.time, "qpos": recording.qpos}
        given = (("qvel", recording.qvel), ("ctrl", recording.ctrl), ("actuator_force", recording.force))
        arrays |= {key: value for key, value in given if value is not None}
    # a slope by wrong times says nothing of velocities
    if out:
        arrays.pop("time", None)
    far = _beyond_torque(recording, model, names) if not out else {}
    out += _joints(arrays, model, names, far)
    out += _actuators(arrays, model, names)
    return out


def _clocks(log: Log, recording: Recording | None) -> Iterator[Doubt]:
    for table in log.tables:
        # a map may have put them right
        time = recording.time if recording is not None and len(log.tables) == 1 else table.time
        if time is None or time.size < 3:
            continue
        step = float(np.median(np.diff(time)))
        title = table.title or "the log"
        if step >= SLOWEST:
            unit = next((u for u, (_, size) in UNITS_OF_TIME.items() if 1e-4 <= step * size <= SLOWEST), None)
            said = f"times of {title} are {step:.4g} apart"
            yield (f"{said}: {unit} for seconds?", {"time": UNITS_OF_TIME[unit][0]}) if unit else (said, {})
        elif 0 < step < 2e-5:
            yield f"times of {title} are {step:.3g} s apart, {1 / step:.3g} rows a second: another unit?", {}


def _beyond_torque(recording: Recording | None, model: mujoco.MjModel, names: Names) -> dict[int, str]:
    """Hinges whose motion, if it were in radians, would need far more torque than they had, and what to say."""
    if recording is None or recording.ctrl is None:
        return {}

    @cache
    def states() -> list[States]:
        return estimate([recording], model, names)[1]

    return dict(not_radians([recording], states, model, names, [recording.ctrl]))


def _joints(
    arrays: dict[str, Array], model: mujoco.MjModel, names: Names, far: Mapping[int, str]
) -> Iterator[Doubt]:
    if "qpos" not in arrays:
        return
    for name, column in joint_columns(model, names, "qpos"):
        q = arrays["qpos"][:, column]
        if np.isnan(q).all():
            continue
        j = names.joints.index(name)
        low, high = (float(x) for x in model.jnt_range[j])
        limited, room = bool(model.jnt_limited[j]), BEYOND * (high - low)
        least, most = float(np.nanmin(q)), float(np.nanmax(q))
        largest, full = max(abs(least), abs(most)), max(LIKE_DEGREES, 2 * max(abs(low), abs(high)))
        span = f"its range of {low:.3g} to {high:.3g}"
        slides = model.jnt_type[j] == SLIDE
        in_degrees = {f"qpos:{name}": "deg"}
        if not slides and limited and largest > full:
            asked = "degrees, or a share of the range?"
            yield f"positions of {name} reach {largest:.3g} beside {span} rad: {asked}", in_degrees
        elif j in far:
            yield f"{far[j]}: degrees?", in_degrees
        elif look_like_degrees(model, j, q):
            yield f"positions of {name} look like degrees; radians are needed", in_degrees
        else:
            in_degrees = {}
            if limited and (least < low - room or most > high + room):
                left = f"positions of {name} ({least:.3g} to {most:.3g}) leave {span}"
                yield f"{left}: another zero, sign or unit?", {}
        yield from _speeds(arrays, model, names, name, q, bool(in_degrees))


def _speeds(
    arrays: dict[str, Array], model: mujoco.MjModel, names: Names, name: str, q: Array, in_degrees: bool
) -> Iterator[Doubt]:
    """Velocities of a joint beside the slope of its positions, which may look like degrees."""
    time, qvel = arrays.get("time"), arrays.get("qvel")
    if qvel is None or time is None or (np.diff(time) <= 0).any() or time.size < ENOUGH:
        return
    v = qvel[:, dict(joint_columns(model, names, "qvel"))[name]]
    if not np.isfinite(v).any() or np.nanmax(np.abs(v)) == 0:
        return
    found, slides = ratio(v, np.gradient(q, time)), model.jnt_type[names.joints.index(name)] == SLIDE
    if in_degrees and (found is None or abs(found - 1) < NEAR):
        yield f"velocities of {name} are degrees a second if those are degrees", {f"qvel:{name}": "deg/s"}
    elif found is not None and (said := meaning(found, slides)):
        unit = {f"{k}:{name}": u for factor, (k, u) in SPEEDS.items() if abs(found / factor - 1) < NEAR}
        yield f"velocities of {name} are {said} beside the slope of its positions", unit


def _actuators(arrays: dict[str, Array], model: mujoco.MjModel, names: Names) -> Iterator[Doubt]:
    ctrl, force, qpos = arrays.get("ctrl"), arrays.get("actuator_force"), arrays.get("qpos")
    low, high = command_limits(model)
    for a, name in enumerate(names.actuators):
        if ctrl is not None and np.isfinite(ctrl[:, a]).any():
            u = ctrl[:, a]
            room = BEYOND * (high[a] - low[a])
            if np.isfinite(room) and (np.nanmin(u) < low[a] - room or np.nanmax(u) > high[a] + room):
                left = f"commands of {name} ({np.nanmin(u):.3g} to {np.nanmax(u):.3g}) leave its ctrlrange"
                yield f"{left} of {low[a]:.3g} to {high[a]:.3g}: another unit?", {}
            if np.ptp(u[np.isfinite(u)]) == 0:
                yield f"the command of {name} never changes", {}
            joint = int(model.actuator_trnid[a, 0])
            if quantity_of(model, a) == "position" and qpos is not None and 0 <= joint < model.njnt:
                found = ratio(u, qpos[:, int(model.jnt_qposadr[joint])])
                slides = model.jnt_type[joint] == SLIDE
                if found is not None and (said := meaning(found, slides)):
                    unit = {} if abs(found * np.pi / 180 - 1) > NEAR or slides else {f"ctrl:{name}": "deg"}
                    yield f"commands of {name} are {said} beside the positions that it is told", unit
        if force is not None and np.isfinite(force[:, a]).any():
            largest, limit = (
                float(np.nanmax(np.abs(force[:, a]))),
                float(np.abs(model.actuator_forcerange[a]).max()),
            )
            if largest == 0:
                yield f"the measured force of {name} is always 0: it was not measured", {}
            if model.actuator_forcelimited[a] and largest > (1 + BEYOND) * limit:
                reached = f"the measured force of {name} reaches {largest:.3g}, its forcerange {limit:.3g}"
                yield f"{reached}: another unit?", {}
