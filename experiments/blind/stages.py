"""What hidden effects add to a plant, and the records that they may look at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from experiments.blind.plant import Plant

Array = NDArray[np.float64]


@dataclass
class DryFriction:
    """A dry force on one degree of freedom, within [-forward, +backward] as `level(velocity, load)` says."""

    dof: int
    level: Callable[[float, float], tuple[float, float]]
    actuators: list[tuple[int, float]]  # (index, gear): what drives this joint


@dataclass
class History:
    """True states of every sub-step so far: row `now` is the present one; `qpos` [S, nq], `qvel` [S, nv]."""

    qpos: Array
    qvel: Array
    now: int = 0


@dataclass
class Stages:
    """Everything that effects add. Callables are run in every sub-step, in the order in which they were added."""

    spec: list[Callable[[mujoco.MjSpec], None]] = field(default_factory=list)  # before compilation
    model: list[Callable[[Plant], None]] = field(default_factory=list)  # after compilation
    command: list[Callable[[Plant, Array], Array]] = field(default_factory=list)  # command -> delayed command
    force: list[Callable[[Plant, Array], Array]] = field(
        default_factory=list
    )  # actuator force -> actuator force
    joint: list[Callable[[Plant, Array], None]] = field(default_factory=list)  # adds to the generalised force
    friction: list[Callable[[Plant], DryFriction]] = field(default_factory=list)  # made after compilation
    sensor: list[Callable[[Plant, History, Array, Array], None]] = field(
        default_factory=list
    )  # edits a measured row
    restart: list[Callable[[], None]] = field(default_factory=list)  # forget delay lines and filters
    drive_joint: dict[str, str] = field(
        default_factory=dict
    )  # joint -> joint that its actuators move instead
