"""What hidden effects add to a plant, and the records that they may look at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Plant = TypeVar("Plant")


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
class Stages(Generic[Plant]):
    """Everything that effects add. Callables are run in every sub-step, in the order in which they were added."""

    # Edits of the model's source, before compilation, and of the compiled plant.
    spec: list[Callable[[mujoco.MjSpec], None]] = field(default_factory=list)
    model: list[Callable[[Plant], None]] = field(default_factory=list)
    # Command [nu] to the command that the actuators see; actuator force [nu] to actuator force.
    command: list[Callable[[Plant, Array], Array]] = field(default_factory=list)
    force: list[Callable[[Plant, Array], Array]] = field(default_factory=list)
    # Adds to the generalised force [nv]; makes a dry friction once the plant is compiled.
    joint: list[Callable[[Plant, Array], None]] = field(default_factory=list)
    friction: list[Callable[[Plant], DryFriction]] = field(default_factory=list)
    # Edits one measured row, qpos [nq] and qvel [nv].
    sensor: list[Callable[[Plant, History, Array, Array], None]] = field(default_factory=list)
    # Forgets delay lines and filters.
    restart: list[Callable[[], None]] = field(default_factory=list)
    # Joint to the joint that its actuators move instead.
    drive_joint: dict[str, str] = field(default_factory=dict)
    # How dry friction sets in; see `joint.LAWS`.
    law: str = "at once"
