"""Robots to measure with: chains of links with dry friction that their model lacks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from mpge_jax import files

_NOISE = 1e-4
"""rad, standard deviation of a recorded position."""
_FINER = 4
"""Steps of the machine in one of its model."""


@dataclass(frozen=True)
class Robots:
    """A fleet to be made.

    Attributes:
      joints: of a robot.
      count: robots.
      runs: recordings of each.
      seconds: that a recording lasts.
      rate: rows a second.
    """

    joints: int
    count: int = 1
    runs: int = 3
    seconds: float = 2.0
    rate: int = 100

    def __post_init__(self) -> None:
        for name in ("joints", "count", "runs", "rate"):
            if getattr(self, name) < 1:
                raise ValueError(f"--{name} must be at least 1, got {getattr(self, name)}")
        if self.seconds < 0.5:
            raise ValueError(f"--seconds must be at least 0.5, got {self.seconds}")


def model(joints: int) -> str:
    """MJCF of a chain in a vertical plane, each link lighter than the one before, a motor at every joint."""
    opened, motors = "", ""
    for k in range(joints):
        mass, place = 1.0 / (1 + k), "" if k == 0 else ' pos="0 0 -.2"'
        opened += f"""<body name="link_{k}"{place}>
<joint name="joint_{k}" axis="0 1 0" damping="{0.05 * mass:.4f}" armature="{0.01 * mass:.4f}"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass="{mass:.4f}" contype="0" conaffinity="0"/>
"""
        motors += f'<motor name="motor_{k}" joint="joint_{k}"/>'
    return (
        '<mujoco model="chain"><option timestep="0.002" integrator="implicitfast"/><worldbody>\n'
        f"{opened}{'</body>' * joints}</worldbody>\n<actuator>{motors}</actuator></mujoco>\n"
    )


def write(robots: Robots, folder: Path) -> None:
    """Writes `model.xml` and `robots/robot_N/run_N.npz`; robot N is drawn from seed N."""
    xml = model(robots.joints)
    files.write_text(folder / "model.xml", xml)
    for number in range(robots.count):
        rng = np.random.default_rng(number)
        # Robots of one make: a few percent apart.
        friction = 0.1 * rng.normal(1.0, 0.03) / np.arange(1, robots.joints + 1)
        for run in range(robots.runs):
            arrays = _record(xml, friction, robots, rng)
            files.write_npz(folder / "robots" / f"robot_{number}" / f"run_{run}.npz", arrays)


def _record(
    xml: str, friction: np.ndarray, robots: Robots, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    machine = mujoco.MjModel.from_xml_string(xml)
    machine.opt.timestep /= _FINER
    data = mujoco.MjData(machine)
    data.qpos[:] = rng.uniform(-0.3, 0.3, machine.nq)
    steps = round(1 / robots.rate / machine.opt.timestep)
    count = int(robots.seconds * robots.rate) + 1
    time = np.arange(count) * steps * machine.opt.timestep
    phase, frequency = rng.uniform(0, 2 * np.pi, (2, 3, machine.nu, 1))
    waves = np.sin((0.5 + 0.3 * frequency) * 2 * np.pi * time + phase)
    ctrl = 0.5 * waves.sum(0).T / np.arange(1, machine.nu + 1)
    qpos = np.empty((count, machine.nq))
    for row in range(count):
        qpos[row] = data.qpos
        data.ctrl[:] = ctrl[row]
        for _ in range(steps):
            data.qfrc_applied[:] = -friction * np.tanh(data.qvel / 0.03)
            mujoco.mj_step(machine, data)
    return {"time": time, "qpos": qpos + _NOISE * rng.standard_normal(qpos.shape), "ctrl": ctrl}
