"""Where an effect can act, which numbers it has, and the scales of a machine that give those numbers their size."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mpge_jax.diagnosis.machine import model as mj
from mpge_jax.diagnosis.machine.contact_pairs import Pairs, allowed_pairs


@dataclass(frozen=True)
class Param:
    """One fitted number: unit, bounds, the scale at which it begins to matter, and a weak Gaussian prior.

    The prior is centred on the start of the fit with deviation `prior` (0: thirty scales); it keeps directions that the
    data do not see where they are, and counts in a fit as often as a window has values. One that is `known` beforehand
    counts once, as each of those does.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    prior: float = 0.0
    known: bool = False


def vector_params(name: str, unit: str, bound: float, scale: float, prior: float) -> tuple[Param, ...]:
    """Three numbers, `name_x` to `name_z` within +-bound, that are reported as one vector."""
    return tuple(Param(f"{name}_{axis}", unit, -bound, bound, scale, prior) for axis in "xyz")


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
        q: [S, nq]. v: [S, nv]. residual: [S, nv] force, less what forces in contacts and loops could be, which nobody
        measured. share: [S, nv] of a force on one degree of freedom that is left in `residual` there: 1 without these.
    """

    q: np.ndarray
    v: np.ndarray
    residual: np.ndarray
    share: np.ndarray


@dataclass(frozen=True)
class Context:
    """A model with the sizes that set the scales of parameters.

    Attributes:
        torque: [nv] typical generalised force. speed: [nv] typical velocity. body_speed: [nbody] of the bodies' centres
        of mass (m/s). travel: [nv] typical range of motion.
        acceleration: [nv]. drive: [nu] typical actuator force (before the gear). length: characteristic length
        of the machine (m). mass: its moving mass (kg). period: median sample time (s). timestep: the nominal
        model's (s). contacts: pairs of geoms that touch.
    """

    model: mujoco.MjModel
    names: mj.Names
    torque: np.ndarray
    speed: np.ndarray
    body_speed: np.ndarray
    travel: np.ndarray
    acceleration: np.ndarray
    drive: np.ndarray
    length: float
    mass: float
    period: float
    timestep: float
    contacts: Pairs = ()
    weight: float = 10.0
    samples: Samples | None = None

    @property
    def touching(self) -> list[int]:
        """Geoms that touch another."""
        return sorted({g for pair in self.contacts for g in pair})

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
        np.full(model.nbody, min(length, 1.0)),
        ones,
        10 * ones,
        force,
        length,
        mass,
        period,
        float(model.opt.timestep),
        contacts=allowed_pairs(model),
        weight=mass * 9.81,
    )


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
        return [Place("geom", names.geoms[g], g) for g in ctx.touching]
    if kind == "world":
        return [Place("world", "world", 0)]
    raise ValueError(f"unknown kind of place '{kind}'.")


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
