"""What the equations of an effect read at one step, and what they may change: forces, and fields of the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Array = Any
"""numpy.ndarray or jax.Array."""


def _nothing(_dof: int) -> Array:
    return 0.0


@dataclass
class Step:
    """What the equations may read at one step.

    Attributes:
        q: [..., nq]. v: [..., nv]. u: [..., nu] command after delay and lag.
        f: [..., nu] actuator force before the gear, as the engine will apply it (native effects included).
        f_free: the same before the clip to [force_low, force_high].
        f_position, f_velocity: [..., nu] derivatives of f by the actuator's length and velocity (servo gains).
        body_velocity: callable body -> [..., 3] world velocity of the body's centre of mass.
        engine: [..., nu] f without what effects compute in the engine's place (None: all of it).
        dt: s. external: callable dof -> [...] torque of gravity and of the other links' motion on that joint.
        inertia: callable dof -> [...] with which that joint resists a torque, all others being free.
    """

    q: Array
    v: Array
    u: Array
    f: Array
    f_free: Array
    force_low: Array
    force_high: Array
    f_position: Array
    f_velocity: Array
    body_velocity: Callable[[int], Array]
    dt: float
    external: Callable[[int], Array] = _nothing
    engine: Array | None = None
    inertia: Callable[[int], Array] = _nothing

    def added_to(self, joint: bool) -> Array:
        """[..., nu] force to which effects of actuators add: of a `joint`, what the engine will apply; else, as they
        add to the command, what is there before the limits."""
        return self.f if joint else self.f_free

    def after(self, xp: Any, actuator: int, more: Forces, joint: bool) -> Step:
        """The same for effects further down the drive train, with `more` force of an actuator (of a `joint`: added to
        its force; else: to its command, before its limits)."""
        if more.actuator is None:
            return self
        here = np.arange(self.f.shape[-1]) == actuator
        added = xp.where(here, xp.asarray(more.actuator)[..., None], 0.0)
        force = self.added_to(joint) + added
        engine = None if self.engine is None else self.engine + added
        return replace(
            self, f=xp.where(here, force, self.f), f_free=xp.where(here, force, self.f_free), engine=engine
        )


@dataclass
class Forces:
    """Forces that an effect adds at one step (None: nothing).

    Attributes:
        joint: generalised force [...] on the place's joint.
        dry: level [...] of dry friction (N m or N) on the place's joint.
        actuator: force [...] added to the place's actuator, before the gear.
        body: force [..., 3] at the place's body's centre of mass, world frame.
    """

    joint: Array | None = None
    dry: Array | None = None
    actuator: Array | None = None
    body: Array | None = None


class Fields:
    """Model fields that an effect may change: `get`, `set`, `add`, `scale` on `field[..., index]`."""

    xp: Any

    def get(self, name: str, index: Any) -> Array:
        raise NotImplementedError

    def set(self, name: str, index: Any, value: Array) -> None:
        raise NotImplementedError

    def add(self, name: str, index: Any, value: Array) -> None:
        self.set(name, index, self.get(name, index) + value)

    def scale(self, name: str, index: Any, factor: Array) -> None:
        self.set(name, index, self.get(name, index) * factor)


Follower = Callable[[Step, tuple[Array, Array], Any], Any]
"""What an effect's memory is after a step of recorded motion: given what equations read where it begins, the position
[n] and speed [n] of the effect's joint where it ends, and the memory before."""
