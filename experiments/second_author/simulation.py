"""The true machine: MuJoCo stepped with whatever hidden effects add to it by hand."""

import copy
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = dict[str, float | list[float]]
SECOND = "_second"
"""Ends the name of the joint between motor and link, where an effect parts the two."""


class Effect:
    """One hidden effect; each hook does nothing unless a subclass says otherwise.

    Attributes:
        id, at: its name and its place (an MJCF name, or `world`). values: its parameters in SI units.
        unknown: no name of the vocabulary stands for it. beyond_range: drives may get more than the range of commands.
        parted: motor and link, or body and contents, have coordinates of their own. in_sensor: it is in what is read
            alone. state: what it remembers between steps; `start` is called at each reset.
    """

    unknown = False
    beyond_range = False
    parted = False
    in_sensor = False

    def __init__(self, name: str, at: str, **values: float | list[float]):
        self.id, self.at, self.values = name, at, dict(values)
        self.state: Any = None

    def start(self) -> None:
        """Forget what was before."""
        self.state = None

    def number(self, name: str) -> float:
        """A scalar parameter."""
        value = self.values[name]
        assert not isinstance(value, list)
        return value

    def edit(self, root: ET.Element) -> None:
        """Change the MJCF tree before it is compiled."""

    def bind(self, sim: "Sim") -> None:
        """Change the compiled model."""

    def command(self, sim: "Sim", u: Array) -> Array:
        """Commands [nu] on their way to the drives."""
        return u

    def before(self, sim: "Sim") -> None:
        """Add forces before a step."""

    def after(self, sim: "Sim") -> None:
        """Look at the state after a step."""

    def sense(self, sim: "Sim", q: Array, v: Array) -> tuple[Array, Array]:
        """What sensors read of positions [nq] and velocities [nv] of the nominal model's coordinates."""
        return q, v


@dataclass(frozen=True)
class Snapshot:
    """Everything that a machine needs to go on from a moment: positions, velocities, and each effect's state."""

    qpos: Array
    qvel: Array
    states: list[Any]


class Sim:
    """A machine with hidden effects. States go in and out in the nominal model's coordinates, which are those of links.

    Args:
        xml: the nominal model. dt: time step [s], that of the model where none is given.
    """

    def __init__(self, xml: str, effects: Sequence[Effect] = (), dt: float | None = None):
        root = ET.fromstring(xml)
        self.effects = list(effects)
        for e in self.effects:
            e.edit(root)
        self.m = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
        if any(e.beyond_range for e in self.effects):
            # the range is that of logged commands, not of what drives make of them
            self.m.actuator_ctrllimited[:] = 0
        if dt:
            self.m.opt.timestep = dt
        self.dt = float(self.m.opt.timestep)
        self.nominal = mujoco.MjModel.from_xml_string(xml)
        self.d = mujoco.MjData(self.m)
        self._joints = {self.m.joint(i).name: i for i in range(self.m.njnt)}
        self._given = {self.nominal.joint(i).name: i for i in range(self.nominal.njnt)}
        self._columns, self._dofs = [], []
        self.parted: list[tuple[int, int, int, int]] = []
        for name, i in self._given.items():
            free = self.nominal.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE
            self._columns += [self.column(name) + k for k in range(7 if free else 1)]
            self._dofs += [self.dof(name) + k for k in range(6 if free else 1)]
            if name + SECOND in self._joints:
                there = self.column(name + SECOND), self.dof(name + SECOND)
                self.parted.append((self.nominal.jnt_qposadr[i], self.nominal.jnt_dofadr[i], *there))
        for e in self.effects:
            e.bind(self)

    def column(self, joint: str) -> int:
        """First index of a joint in the true machine's positions."""
        return int(self.m.jnt_qposadr[self._joints[joint]])

    def dof(self, joint: str) -> int:
        """First index of a joint in the true machine's velocities."""
        return int(self.m.jnt_dofadr[self._joints[joint]])

    def actuator(self, name: str) -> int:
        """Index of an actuator."""
        return int(self.m.actuator(name).id)

    def given_column(self, joint: str) -> int:
        """First index of a joint in the nominal model's positions."""
        return int(self.nominal.jnt_qposadr[self._given[joint]])

    def given_dof(self, joint: str) -> int:
        """First index of a joint in the nominal model's velocities."""
        return int(self.nominal.jnt_dofadr[self._given[joint]])

    def set_timestep(self, dt: float) -> None:
        """Step by `dt` seconds from here on."""
        self.m.opt.timestep = self.dt = dt

    def reset(self, q: Array, v: Array) -> None:
        """Start from positions [nq] and velocities [nv]."""
        mujoco.mj_resetData(self.m, self.d)
        self.d.qpos[self._columns], self.d.qvel[self._dofs] = q, v
        for e in self.effects:
            e.start()
        mujoco.mj_forward(self.m, self.d)

    def link(self) -> tuple[Array, Array]:
        """True positions [nq] and velocities [nv] of the links."""
        q, v = self.d.qpos[self._columns].copy(), self.d.qvel[self._dofs].copy()
        for column, dof, second_column, second_dof in self.parted:
            q[column] += self.d.qpos[second_column]
            v[dof] += self.d.qvel[second_dof]
        return q, v

    def at_motors(self, q: Array) -> Array:
        """Positions [nq] as encoders at the motors would have them, of those read at the links."""
        q = q.copy()
        for column, _, second_column, _ in self.parted:
            q[column] -= self.d.qpos[second_column]
        return q

    def measured(self) -> tuple[Array, Array]:
        """Positions [nq] and velocities [nv] as sensors read them, without noise."""
        q, v = self.link()
        for e in self.effects:
            q, v = e.sense(self, q, v)
        return q, v

    def step(self, u: Array) -> None:
        """One time step with commands [nu]."""
        for e in self.effects:
            u = e.command(self, u)
        self.d.ctrl[:] = u
        self.d.qfrc_applied[:] = 0
        self.d.xfrc_applied[:] = 0
        for e in self.effects:
            e.before(self)
        mujoco.mj_step(self.m, self.d)
        for e in self.effects:
            e.after(self)

    def hold(self, u: Array, seconds: float, step: float) -> None:
        """Commands [nu] for so long, in steps of about `step` seconds."""
        count = max(1, round(seconds / step))
        self.set_timestep(seconds / count)
        for _ in range(count):
            self.step(u)

    def snapshot(self) -> Snapshot:
        """The state at this moment."""
        return Snapshot(self.d.qpos.copy(), self.d.qvel.copy(), [copy.copy(e.state) for e in self.effects])


def element(root: ET.Element, tag: str, name: str) -> ET.Element:
    """The element of an MJCF tree with this tag and name."""
    return next(e for e in root.iter(tag) if e.get("name") == name)


def sign(x: float) -> float:
    """-1, 0 or 1."""
    return 1.0 if x > 0 else (-1.0 if x < 0 else 0.0)
