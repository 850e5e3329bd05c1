"""Hidden effects in joints: friction, springs, cogging, rotor inertia, transmissions that give, cables."""

import xml.etree.ElementTree as ET

import numpy as np

from experiments.second_author.simulation import SECOND, Effect, Sim, element, sign


def stick(joint: ET.Element) -> None:
    """Let dry friction hold as the law says: MuJoCo's own softness would let the joint creep."""
    joint.set("solreffriction", ".004 1")
    joint.set("solimpfriction", ".99 .999 .001")


def rub(root: ET.Element, joint: str, bound: float) -> None:
    """Dry friction of that bound to begin with, which is set anew at each step."""
    found = element(root, "joint", joint)
    found.set("frictionloss", repr(bound))
    stick(found)


def add(joint: ET.Element, key: str, x: float) -> None:
    """Add to an attribute that may not be there."""
    joint.set(key, repr(float(joint.get(key, "0")) + x))


class Viscous(Effect):
    """Torque against the motion, `coefficient` times the velocity."""

    def __init__(self, at: str, coefficient: float):
        super().__init__("viscous_damping", at, coefficient=coefficient)

    def edit(self, root: ET.Element) -> None:
        add(element(root, "joint", self.at), "damping", self.number("coefficient"))


class Armature(Effect):
    """Inertia of a rotor, as the joint feels it."""

    def __init__(self, at: str, inertia: float):
        super().__init__("armature", at, inertia=inertia)

    def edit(self, root: ET.Element) -> None:
        add(element(root, "joint", self.at), "armature", self.number("inertia"))


class Coulomb(Effect):
    """Dry friction up to `torque`."""

    def __init__(self, at: str, torque: float):
        super().__init__("coulomb_friction", at, torque=torque)

    def edit(self, root: ET.Element) -> None:
        joint = element(root, "joint", self.at)
        add(joint, "frictionloss", self.number("torque"))
        stick(joint)


class Stribeck(Effect):
    """Dry friction whose bound falls from `static` to `coulomb` around a `velocity`; it is set anew at each step."""

    def __init__(self, at: str, coulomb: float, static: float, velocity: float):
        super().__init__("stribeck_friction", at, coulomb=coulomb, static=static, velocity=velocity)

    def edit(self, root: ET.Element) -> None:
        rub(root, self.at, self.number("static"))

    def before(self, sim: Sim) -> None:
        dof = sim.dof(self.at)
        x = sim.d.qvel[dof] / self.number("velocity")
        low, high = self.number("coulomb"), self.number("static")
        sim.m.dof_frictionloss[dof] = low + (high - low) * np.exp(-x * x)


class LoadFriction(Effect):
    """Dry friction that grows with the torque of a plain motor."""

    def __init__(self, at: str, actuator: str, coulomb: float, load_coefficient: float):
        super().__init__("load_dependent_friction", at, coulomb=coulomb, load_coefficient=load_coefficient)
        self.actuator = actuator

    def edit(self, root: ET.Element) -> None:
        rub(root, self.at, self.number("coulomb"))

    def before(self, sim: Sim) -> None:
        a = sim.actuator(self.actuator)
        load = sim.m.actuator_gainprm[a, 0] * sim.d.ctrl[a] * sim.m.actuator_gear[a, 0]
        bound = self.number("coulomb") + self.number("load_coefficient") * abs(load)
        sim.m.dof_frictionloss[sim.dof(self.at)] = bound


class Cogging(Effect):
    """Torque that repeats `periods` times a turn."""

    def __init__(self, at: str, amplitude: float, phase: float, periods: float):
        super().__init__("cogging_torque", at, amplitude=amplitude, phase=phase, periods=periods)

    def before(self, sim: Sim) -> None:
        q = sim.d.qpos[sim.column(self.at)]
        angle = self.number("periods") * q + self.number("phase")
        sim.d.qfrc_applied[sim.dof(self.at)] += self.number("amplitude") * np.sin(angle)


class Stiffness(Effect):
    """A spring that rests at `reference`."""

    def __init__(self, at: str, stiffness: float, reference: float):
        super().__init__("joint_stiffness", at, stiffness=stiffness, reference=reference)

    def before(self, sim: Sim) -> None:
        q = sim.d.qpos[sim.column(self.at)]
        sim.d.qfrc_applied[sim.dof(self.at)] -= self.number("stiffness") * (q - self.number("reference"))


class Parted(Effect):
    """Motor and link get joints of their own; the link's angle is the sum of the two, and that is recorded."""

    parted = True

    def edit(self, root: ET.Element) -> None:
        parents = {child: parent for parent in root.iter() for child in parent}
        joint = element(root, "joint", self.at)
        body = parents[joint]
        above = parents[body]
        rotor = ET.Element("body", name=self.at + "_rotor", pos=body.get("pos", "0 0 0"))
        index = list(above).index(body)
        above.remove(body)
        above.insert(index, rotor)
        body.set("pos", "0 0 0")
        body.remove(joint)
        rotor.append(joint)
        ET.SubElement(rotor, "inertial", pos="0 0 0", mass="1e-6", diaginertia="1e-8 1e-8 1e-8")
        second = ET.Element(
            "joint", name=self.at + SECOND, axis=joint.get("axis", "0 0 1"), type=joint.get("type", "hinge")
        )
        self.between(second)
        body.insert(0, second)
        rotor.append(body)

    def between(self, joint: ET.Element) -> None:
        """What MuJoCo itself has between the two."""


class Flexible(Parted):
    """A spring and a damper between motor and link."""

    def __init__(self, at: str, stiffness: float, damping: float):
        super().__init__("joint_flexibility", at, stiffness=stiffness, damping=damping)

    def between(self, joint: ET.Element) -> None:
        joint.set("stiffness", repr(self.number("stiffness")))
        joint.set("damping", repr(self.number("damping")))


class Backlash(Parted):
    """A gap between motor and link. Its ends are stiff springs with a damper, which together never pull.

    Args:
        restitution: velocity after an impact over that before. stiffness: of the ends [N m/rad]. inertia: reduced, of
            motor against link [kg m^2].
    """

    def __init__(self, at: str, gap: float, restitution: float, stiffness: float, inertia: float):
        super().__init__("backlash", at, gap=gap)
        self.stiffness = stiffness
        ratio = -np.log(restitution) / np.sqrt(np.pi**2 + np.log(restitution) ** 2)
        self.damping = 2 * ratio * np.sqrt(stiffness * inertia)

    def before(self, sim: Sim) -> None:
        column, dof = sim.column(self.at + SECOND), sim.dof(self.at + SECOND)
        q, v, half = sim.d.qpos[column], sim.d.qvel[dof], self.number("gap") / 2
        if q > half:
            sim.d.qfrc_applied[dof] += min(0.0, -self.stiffness * (q - half) - self.damping * v)
        elif q < -half:
            sim.d.qfrc_applied[dof] += max(0.0, -self.stiffness * (q + half) - self.damping * v)


class Dahl(Effect):
    """A bundle of cables with hysteresis (Dahl): a spring at first, then slipping, by the way that was gone.

    Args:
        most: the torque at which it slips [N m]. reach: angle over which it is a spring [rad].
    """

    unknown = True

    def __init__(self, at: str, most: float, reach: float):
        super().__init__("hysteresis", at, most=most, reach=reach)
        self.stiffness = most / reach

    def start(self) -> None:
        self.state = 0.0

    def before(self, sim: Sim) -> None:
        dof = sim.dof(self.at)
        v = sim.d.qvel[dof]
        self.state += sim.dt * self.stiffness * v * (1 - sign(v) * self.state / self.number("most"))
        sim.d.qfrc_applied[dof] -= self.state
