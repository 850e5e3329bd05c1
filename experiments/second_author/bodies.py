"""Hidden effects in bodies and the world: loads, liquids, centres of mass, gravity, air, contacts."""

import xml.etree.ElementTree as ET

import mujoco
import numpy as np

from experiments.second_author.simulation import Effect, Sim, element


class Payload(Effect):
    """A point mass fixed to a body, at a `position` in its frame [m]."""

    def __init__(self, at: str, mass: float, position: list[float]):
        super().__init__("payload_mass", at, mass=mass, position=position)
        self.position = position

    def edit(self, root: ET.Element) -> None:
        pos = " ".join(map(str, self.position))
        point = ET.SubElement(element(root, "body", self.at), "body", pos=pos)
        mass = repr(self.number("mass"))
        ET.SubElement(point, "inertial", pos="0 0 0", mass=mass, diaginertia="1e-9 1e-9 1e-9")


class ComOffset(Effect):
    """A centre of mass that lies elsewhere by `offset` [m]."""

    def __init__(self, at: str, offset: list[float]):
        super().__init__("com_offset", at, offset=offset)

    def bind(self, sim: Sim) -> None:
        sim.m.body_ipos[sim.m.body(self.at).id] += self.values["offset"]
        mujoco.mj_setConst(sim.m, sim.d)


class Tilt(Effect):
    """Gravity turned by an `angle` about an `axis` of length 1 (Rodrigues' formula)."""

    def __init__(self, angle: float, axis: list[float]):
        super().__init__("gravity_tilt", "world", angle=angle, axis=axis)

    def bind(self, sim: Sim) -> None:
        axis, gravity = np.asarray(self.values["axis"], float), sim.m.opt.gravity.copy()
        c, t = np.cos(self.values["angle"]), self.number("angle")
        turned = gravity * c + np.cross(axis, gravity) * np.sin(t) + axis * (axis @ gravity) * (1 - c)
        sim.m.opt.gravity[:] = turned


class Drag(Effect):
    """Air drag at a body's centre of mass: `coefficient` times the square of its speed."""

    def __init__(self, at: str, coefficient: float):
        super().__init__("quadratic_drag", at, coefficient=coefficient)

    def before(self, sim: Sim) -> None:
        body, spatial = sim.m.body(self.at).id, np.zeros(6)
        mujoco.mj_objectVelocity(sim.m, sim.d, mujoco.mjtObj.mjOBJ_BODY, body, spatial, 0)
        v = spatial[3:]
        sim.d.xfrc_applied[body, :3] -= self.number("coefficient") * np.linalg.norm(v) * v


class ContactFriction(Effect):
    """Sliding friction `mu` of every geom."""

    def __init__(self, mu: float):
        super().__init__("contact_friction", "world", mu=mu)

    def bind(self, sim: Sim) -> None:
        sim.m.geom_friction[:, 0] = self.number("mu")


class ContactStiffness(Effect):
    """The time constant [s] of every geom's contacts."""

    def __init__(self, time_constant: float):
        super().__init__("contact_stiffness", "world", time_constant=time_constant)

    def bind(self, sim: Sim) -> None:
        sim.m.geom_solref[:, 0] = self.number("time_constant")


class Slosh(Effect):
    """Liquid in a tank: a `share` of its mass swings as a damped pendulum that the model has rigid.

    Args:
        at: the joint that tips the tank, where it acts most. body: the tank. frequency: of the liquid [Hz].
        ratio: its damping over the critical one.
    """

    unknown = True
    parted = True

    def __init__(self, at: str, body: str, share: float, frequency: float, ratio: float):
        super().__init__("slosh", at, share=share, frequency=frequency, ratio=ratio)
        self.body = body

    def edit(self, root: ET.Element) -> None:
        body = element(root, "body", self.body)
        geom = body.find("geom")
        assert geom is not None
        total, turning = float(geom.get("mass", "0")), 2 * np.pi * self.number("frequency")
        liquid = self.number("share") * total
        geom.set("mass", repr(total - liquid))
        length = 9.81 / turning**2
        damping = 2 * self.number("ratio") * liquid * length**2 * 2 * np.pi * self.number("frequency")
        swings = ET.SubElement(body, "body", name="liquid", pos=f"0 0 {length}")
        hinge = {"name": "liquid_swing", "type": "hinge", "axis": "0 1 0", "damping": repr(damping)}
        ET.SubElement(swings, "joint", hinge)
        mass = {"pos": f"0 0 {-length}", "mass": repr(liquid), "diaginertia": "1e-5 1e-5 1e-5"}
        ET.SubElement(swings, "inertial", mass)
