"""What an effect is: its parameters, where it can act, and its equations.

Equations are written once, for NumPy and `jax.numpy` alike (`xp`), with any leading batch dimensions: theta is
[..., p], states are [..., nq]. Hooks that an effect does not need stay as they are here.

- `model`    changes fields of the MuJoCo model (native effects);
- `force`    adds forces each step, with a memory if it needs one;
- `command`  changes the command each step (delay, lag), with a memory;
- `timeline` is the same over a whole recorded timeline at once (overridden only for speed);
- `sense`    offset and delay of the measured position.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis import model as mj

Array = Any
"""numpy.ndarray or jax.Array."""


@dataclass(frozen=True)
class Param:
    """One fitted number: unit, bounds, the scale at which it begins to matter, and a weak Gaussian prior.

    The prior is centred on the start of the fit with deviation `prior` (0: thirty scales); it keeps directions
    that the data do not see where they are.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    prior: float = 0.0


@dataclass(frozen=True)
class Place:
    """Where an effect acts: an element of the model, by kind, name and index."""

    kind: str
    name: str
    index: int


@dataclass(frozen=True)
class Samples:
    """Smoothed states with the generalised force that the nominal model lacks there.

    Attributes:
        q: [S, nq]. v: [S, nv]. residual: [S, nv].
    """

    q: np.ndarray
    v: np.ndarray
    residual: np.ndarray


@dataclass(frozen=True)
class Context:
    """A model with the sizes that set the scales of parameters.

    Attributes:
        torque: [nv] typical generalised force. speed: [nv] typical velocity. travel: [nv] typical range of motion.
        acceleration: [nv]. drive: [nu] typical actuator force (before the gear). length: characteristic length
        of the machine (m). mass: its moving mass (kg). period: median sample time (s).
    """

    model: mujoco.MjModel
    names: mj.Names
    torque: np.ndarray
    speed: np.ndarray
    travel: np.ndarray
    acceleration: np.ndarray
    drive: np.ndarray
    length: float
    mass: float
    period: float
    contacts: tuple[int, ...] = ()
    weight: float = 10.0
    samples: Samples | None = None

    def dof(self, place: Place) -> int:
        return int(self.model.jnt_dofadr[place.index])

    def qadr(self, place: Place) -> int:
        return int(self.model.jnt_qposadr[place.index])


def nominal_context(model: mujoco.MjModel, period: float = 0.01) -> Context:
    """Scales for a model alone, for use without recordings."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    ones = np.ones(model.nv)
    mass = max(float(model.body_mass[mj.moving_bodies(model)].sum()), 1e-3)
    moving = mj.moving_bodies(model)
    length = float(np.ptp(data.xipos[[0, *moving]], axis=0).max()) if moving else 1.0
    force = np.ones(model.nu)
    for a in range(model.nu):
        low, high = model.actuator_forcerange[a] if model.actuator_forcelimited[a] else (-1.0, 1.0)
        force[a] = max(abs(low), abs(high))
    length = max(length, 0.05)
    return Context(
        model,
        mj.names_of(model),
        ones * max(mass * 9.81 * length / 2, 1e-3),
        ones,
        ones,
        10 * ones,
        force,
        length,
        mass,
        period,
        contacts=tuple(range(model.ngeom)),
        weight=mass * 9.81,
    )


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
        dt: s. external: callable dof -> [...] torque of gravity and of the other links' motion on that joint.
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


class Effect:
    """Base class. A new effect sets `id`, `kinds`, `params`, and one or more hooks; see `register`."""

    id: str = ""
    """Identifier; a second form of an effect carries its name after a colon and is reported without it."""
    kinds: tuple[str, ...] = ()
    side: str = "mechanical"
    """Where it stands in the chain: mechanical, actuator, or sensor."""
    order: int = 0
    """Effects of one actuator apply in this order."""
    tier: int = 1
    """How plain an explanation it is; among explanations that fit alike, lower tiers are preferred."""
    equation: str = ""
    runtime = False
    """Whether `force` must be called each step."""
    commands = False
    """Whether it changes the command (`command`)."""
    jagged = False
    """Whether predictions jump with the parameters (contacts), so that the fit must also try without slopes."""
    senses = False
    """Whether it changes the measurement (`sense`)."""
    remedy: str = ""
    """What recording shows the effect best."""
    fields: tuple[str, ...] = ()
    """Model fields that `model` touches."""
    set_const = False
    """Whether derived constants must follow (masses, inertias, armature)."""

    def params(self, ctx: Context, place: Place) -> tuple[Param, ...]:
        return ()

    def places(self, ctx: Context) -> list[Place]:
        return [p for kind in self.kinds for p in default_places(ctx, kind)]

    def starts(self, ctx: Context, place: Place) -> np.ndarray:
        """Starting values [k, p] for the fit, small effects first."""
        return np.array([[p.scale for p in self.params(ctx, place)]])

    def model(self, f: Fields, ctx: Context, place: Place, theta: Array) -> None:
        """Change model fields; theta [..., p]."""

    def memory(self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step) -> Any:
        """Memory of `force` at the start of a stretch that begins in state s."""
        return ()

    def force(
        self, xp: Any, ctx: Context, place: Place, theta: Array, s: Step, memory: Any
    ) -> tuple[Forces, Any]:
        return Forces(), memory

    def command_memory(self, xp: Any, ctx: Context, place: Place, u: Array, dt: float) -> Any:
        return ()

    def command(self, xp: Any, theta: Array, u: Array, memory: Any, dt: float) -> tuple[Array, Any]:
        """Command [...] that reaches the actuator in this step."""
        return u, memory

    def timeline(self, ctx: Context, place: Place, theta: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
        """`command` over a whole timeline u [n, L] of consecutive steps."""
        memory = self.command_memory(np, ctx, place, u[:, 0], dt)
        out = np.empty_like(u)
        for k in range(u.shape[1]):
            out[:, k], memory = self.command(np, theta, u[:, k], memory, dt)
        return out

    def sense(self, theta: Array) -> tuple[Array | float, Array | float]:
        """(offset, delay) of the measured position of the place's joint."""
        return 0.0, 0.0

    def report(self, ctx: Context, place: Place, theta: np.ndarray) -> dict[str, np.ndarray]:
        """Parameters [..., p] as the vocabulary names them: name -> value [...] or vector [..., 3]."""
        return {p.name: theta[..., i] for i, p in enumerate(self.params(ctx, place))}

    def from_report(self, ctx: Context, place: Place, values: dict[str, Any]) -> np.ndarray:
        """Inverse of `report`: theta [p]."""
        return np.array([float(values[p.name]) for p in self.params(ctx, place)])

    def units(self, ctx: Context, place: Place) -> dict[str, str]:
        return {p.name: p.unit for p in self.params(ctx, place)}

    def naming(self, ctx: Context, place: Place) -> list[int]:
        """Indices of the parameters of which at least one must differ from `null` for the effect to exist."""
        return [0] if self.params(ctx, place) else []

    def null(self, ctx: Context, place: Place) -> np.ndarray:
        """Parameters at which the effect vanishes."""
        return np.zeros(len(self.params(ctx, place)))

    def special(self, ctx: Context, place: Place, theta: np.ndarray, deviation: np.ndarray) -> str | None:
        """Identifier of a limiting case under its own name (a gain of zero is a dead actuator)."""
        return None

    def export(self, spec: mujoco.MjSpec, ctx: Context, place: Place, theta: np.ndarray) -> bool:
        """Add the native MJCF form to the spec. Returns False where MuJoCo has none."""
        return False

    def sentence(self, place: Place, values: dict[str, Any]) -> str:
        """One plain sentence for the report; `values` are formatted parameters."""
        shown = ", ".join(f"{k} {v}" for k, v in values.items())
        return f"{place.name} has {self.id.replace('_', ' ')} that the model lacks ({shown})."


REGISTRY: dict[str, Effect] = {}


def register(effect: type[Effect]) -> type[Effect]:
    """Class decorator: add an effect to the vocabulary. It is then screened, fitted, reported and exported."""
    instance = effect()
    if not instance.id or not instance.kinds:
        raise ValueError(f"{effect.__name__} must set 'id' and 'kinds'.")
    if instance.id in REGISTRY and type(REGISTRY[instance.id]).__qualname__ != effect.__qualname__:
        raise ValueError(f"an effect named '{instance.id}' exists already.")
    REGISTRY[instance.id] = instance
    return effect


def default_places(ctx: Context, kind: str) -> list[Place]:
    """Every place of a kind where something can act."""
    m, names = ctx.model, ctx.names
    if kind == "joint":
        base = mj.floating_base_joints(m)
        return [Place("joint", names.joints[j], j) for j in mj.scalar_joints(m) if j not in base]
    if kind == "actuator":
        return [Place("actuator", names.actuators[a], a) for a in range(m.nu)]
    if kind == "body":
        return [Place("body", names.bodies[b], b) for b in mj.moving_bodies(m)]
    if kind == "geom":
        touching = [g for g in ctx.contacts if g < m.ngeom]
        return [Place("geom", names.geoms[g], g) for g in touching]
    if kind == "world":
        return [Place("world", "world", 0)]
    raise ValueError(f"unknown kind of place '{kind}'.")


def find_place(ctx: Context, effect: Effect, name: str) -> Place:
    """The place of that name, of the kinds on which the effect acts."""
    for kind in effect.kinds:
        for place in all_places(ctx, kind):
            if place.name == name:
                return place
    raise ValueError(
        f"{effect.id} cannot act at '{name}': the model has no such {' or '.join(effect.kinds)}."
    )


def all_places(ctx: Context, kind: str) -> list[Place]:
    m, names = ctx.model, ctx.names
    if kind == "joint":
        return [Place("joint", names.joints[j], j) for j in mj.scalar_joints(m)]
    if kind == "body":
        return [Place("body", names.bodies[b], b) for b in range(1, m.nbody)]
    if kind == "geom":
        return [Place("geom", names.geoms[g], g) for g in range(m.ngeom)]
    return default_places(ctx, kind)


def joint_unit(ctx: Context, place: Place, hinge: str, slide: str) -> str:
    return hinge if ctx.model.jnt_type[place.index] == mujoco.mjtJoint.mjJNT_HINGE else slide


def spec_joint(spec: mujoco.MjSpec, index: int) -> Any:
    """The joint of that index in a compiled model's order."""
    return _by_id(spec.joints, index)


def spec_body(spec: mujoco.MjSpec, index: int) -> Any:
    return _by_id(spec.bodies, index)


def spec_actuator(spec: mujoco.MjSpec, index: int) -> Any:
    return _by_id(spec.actuators, index)


def spec_geom(spec: mujoco.MjSpec, index: int) -> Any:
    return _by_id(spec.geoms, index)


def _by_id(elements: Any, index: int) -> Any:
    return next(e for e in elements if e.id == index)
