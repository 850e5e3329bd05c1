"""What is known of a machine that is to have a task: its base, its joints, where it starts, how far commands go."""

import os
import re
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine.model import actuators_of_joint, is_joint_transmission, load_spec

SECONDS = 0.02
"""Of one step of the policy, or a physics step where that is longer."""


@dataclass(frozen=True)
class Robot:
    """What is known of a model.

    Attributes:
      name: of the task. file: the task file's name. model: the model's path from there.
      timestep: s. frame_skip: physics steps in one step.
      start: qpos in which episodes start. pose: where that is from.
      base: columns of qpos that place a moving base, by name; empty for a fixed one.
      height: of the base above the ground at the start, m.
      joints: columns of qpos of hinges and slides that do not place the base.
      nv: size of qvel. ranges: (actuator, low, high) where the model has no control range.
      mass: kg. hidden: whether actuators have states of their own, which no observation tells.
    """

    name: str
    file: str
    model: str
    timestep: float
    frame_skip: int
    start: tuple[float, ...]
    pose: str
    base: dict[str, int]
    height: float
    joints: tuple[int, ...]
    nv: int
    ranges: tuple[tuple[int, float, float], ...]
    mass: float
    hidden: bool


def robot_of(path: Path, out: Path, name: str | None = None) -> Robot:
    """What a task file says of a model.

    Args:
      path: the model. out: where the task file will lie. name: of the task; else from the model's file.

    Raises:
      ValueError: the model cannot be read, or has no actuator that a policy could use.
    """
    if name is not None and not re.fullmatch(r"[A-Za-z][\w.-]*", name):
        raise ValueError(
            f"a task's name has letters, digits, '.', '-' and '_' only, and begins with a letter: not {name!r}"
        )
    spec = load_spec(path)
    try:
        m = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise ValueError(f"MuJoCo cannot compile {path}: {' '.join(str(error).split())}") from None
    if not m.nu:
        raise ValueError(
            f"{path} has no actuators, so there is nothing for a policy to do; add an <actuator>"
        )
    data = mujoco.MjData(m)
    key = next((k for k in range(m.nkey) if m.key(k).name == "home"), 0 if m.nkey else None)
    if key is not None:
        mujoco.mj_resetDataKeyframe(m, data, key)
    mujoco.mj_forward(m, data)
    base = _base(m)
    added = {}
    for a in range(m.nu):
        if not m.actuator_ctrllimited[a]:
            added[a] = _range(m, a)
    scalar = np.isin(m.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
    joints = [
        int(m.jnt_qposadr[j]) for j in np.flatnonzero(scalar) if int(m.jnt_qposadr[j]) not in base.values()
    ]
    body = int(m.jnt_bodyid[0]) if base else 0
    return Robot(
        name=name or name_of(path.stem),
        file=out.name,
        model=os.path.relpath(path.resolve(), out.resolve().parent),
        timestep=float(m.opt.timestep),
        frame_skip=max(1, round(SECONDS / m.opt.timestep)),
        start=tuple(float(f"{x:.6g}") for x in data.qpos),
        pose="the reference pose" if key is None else f"keyframe {m.key(key).name or key}",
        base=base,
        height=float(data.xpos[body][2]),
        joints=tuple(joints),
        nv=m.nv,
        ranges=tuple((i, float(lo), float(hi)) for i, (lo, hi) in added.items()),
        mass=float(m.body_mass.sum()),
        hidden=bool(m.na),
    )


def name_of(stem: str) -> str:
    """The name of a task from that of a file."""
    words = re.findall(r"[A-Za-z0-9]+", stem) or ["Robot"]
    name = "".join(word[0].upper() + word[1:] for word in words)
    return name if name[0].isalpha() else f"Robot{name}"


def _base(m: mujoco.MjModel) -> dict[str, int]:
    """Columns of qpos that place a moving base: of a free joint `x`, `y`, `z`, `quat`; of a planar one `x`, `z`,
    `pitch`; none where the base is fixed, or the model's first body moves otherwise."""
    if not m.njnt or m.body_parentid[m.jnt_bodyid[0]] != 0:
        return {}
    q = int(m.jnt_qposadr[0])
    if m.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        return {"x": q, "y": q + 1, "z": q + 2, "quat": q + 3}
    found: dict[str, int] = {}
    for j in np.flatnonzero(m.jnt_bodyid == m.jnt_bodyid[0]):
        axis, slide = int(np.abs(m.jnt_axis[j]).argmax()), m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
        name = {(True, 0): "x", (True, 2): "z", (False, 1): "pitch"}.get((bool(slide), axis))
        if name is not None and not actuators_of_joint(m, int(j)):
            found[name] = int(m.jnt_qposadr[j])
    return found if set(found) == {"x", "z", "pitch"} else {}


def _range(m: mujoco.MjModel, a: int) -> tuple[float, float]:
    """A control range for an actuator that has none: its joint's range for a servo, its force's limits for a motor."""
    gain = abs(float(m.actuator_gainprm[a, 0])) or 1.0
    joint = int(m.actuator_trnid[a, 0]) if is_joint_transmission(m, a) else None
    if m.actuator_biasprm[a, 1] != 0:
        if joint is not None and m.jnt_limited[joint]:
            low, high = m.jnt_range[joint]
            return float(low), float(high)
        return -1.0, 1.0
    if m.actuator_forcelimited[a]:
        low, high = m.actuator_forcerange[a] / gain
        return float(low), float(high)
    return -1.0, 1.0
