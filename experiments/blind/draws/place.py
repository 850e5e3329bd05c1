"""Where an effect is drawn, and the random helpers that all draws share."""

from dataclasses import dataclass

import mujoco
import numpy as np

from experiments.blind.robots.robot import Robot
from experiments.blind.visibility.statistics import Statistics

Parameters = dict[str, float | list[float]]


@dataclass(frozen=True)
class Place:
    """Where an effect is drawn, on which machine, with what random numbers."""

    robot: Robot
    stats: Statistics
    at: str
    actuator: int  # index, -1 where none is meant
    dt: float
    seed: int

    def rng(self) -> np.random.Generator:
        """The same numbers for every size, so that a size only scales."""
        return np.random.default_rng(self.seed)

    @property
    def torque(self) -> float:
        return self.stats.torque(self.at)

    @property
    def speed(self) -> float:
        return self.stats.speed(self.at)

    @property
    def force_rms(self) -> float:
        return float(np.sqrt((self.stats.force(self.actuator) ** 2).mean()))

    def is_joint(self) -> bool:
        """Whether `at` names a joint of the model."""
        return mujoco.mj_name2id(self.stats.model, mujoco.mjtObj.mjOBJ_JOINT, self.at) >= 0

    def direction(self, rng: np.random.Generator) -> np.ndarray:
        """A random unit vector within what can be observed."""
        v = np.zeros(3)
        v[list(self.robot.plane)] = rng.standard_normal(len(self.robot.plane))
        return v / np.linalg.norm(v)


def sign(rng: np.random.Generator, positive: float = 0.5) -> float:
    """+1 with the given probability, else -1."""
    return 1.0 if rng.random() < positive else -1.0


def whole_steps(value: float, dt: float, low: float, high: float) -> float:
    """The value within its bounds, as a whole number (at least one) of sub-steps."""
    return round(max(1, round(min(max(value, low), high) / dt)) * dt, 9)
