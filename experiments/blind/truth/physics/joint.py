"""Effects in the joints: forces of position and velocity, dry friction, rotor inertia."""

import math
from collections.abc import Callable

import numpy as np

from experiments.blind.truth.plant import Plant
from experiments.blind.truth.stages import DryFriction, Stages
from experiments.blind.vocabulary import Effect

CREEP = 0.02
"""Speed at which a creeping friction is three quarters of its level (rad/s or m/s)."""
BRISTLE = 0.003
"""Way after a reversal at which friction is two thirds of its level (rad or m)."""


def viscous_damping(effect: Effect, stages: Stages[Plant]) -> None:
    """-b v"""
    b, joint = effect.number("coefficient"), effect.at

    def add(plant: Plant, extra: np.ndarray) -> None:
        extra[plant.dof(joint)] -= b * plant.v(joint)

    stages.joint.append(add)


def quadratic_drag(effect: Effect, stages: Stages[Plant]) -> None:
    """-d v |v| at a joint, or at a body's centre of mass (v its linear velocity in the world)."""
    d, at = effect.number("coefficient"), effect.at

    def add(plant: Plant, extra: np.ndarray) -> None:
        if at in plant.joints:
            v = plant.v(at)
            extra[plant.dof(at)] -= d * v * abs(v)
        else:
            velocity = plant.body_velocity(at)
            plant.push(at, -d * np.linalg.norm(velocity) * velocity, extra)

    stages.joint.append(add)


def joint_stiffness(effect: Effect, stages: Stages[Plant]) -> None:
    """-k (q - q0)"""
    k, q0, joint = effect.number("stiffness"), effect.number("reference"), effect.at

    def add(plant: Plant, extra: np.ndarray) -> None:
        extra[plant.dof(joint)] -= k * (plant.q(joint) - q0)

    stages.joint.append(add)


def cogging_torque(effect: Effect, stages: Stages[Plant]) -> None:
    """+A sin(n q + phi)"""
    a, n, phi = (effect.number(p) for p in ("amplitude", "periods", "phase"))
    joint = effect.at

    def add(plant: Plant, extra: np.ndarray) -> None:
        extra[plant.dof(joint)] += a * math.sin(n * plant.q(joint) + phi)

    stages.joint.append(add)


def armature(effect: Effect, stages: Stages[Plant]) -> None:
    """-J a: inertia added to the joint's own entry of the mass matrix."""
    inertia, joint = effect.number("inertia"), effect.at

    def tune(plant: Plant) -> None:
        plant.model.dof_armature[plant.dof(joint)] += inertia
        plant.refresh()

    stages.model.append(tune)


def coulomb_friction(effect: Effect, stages: Stages[Plant]) -> None:
    """-Fc sgn v"""
    fc = effect.number("torque")
    _dry(effect.at, stages, lambda v, load: (fc, fc))


def stribeck_friction(effect: Effect, stages: Stages[Plant]) -> None:
    """-(Fc + (Fs - Fc) exp(-(v / vs)^2)) sgn v"""
    fc, fs, vs = (effect.number(p) for p in ("coulomb", "static", "velocity"))

    def level(v: float, load: float) -> tuple[float, float]:
        f = fc + (fs - fc) * math.exp(-((v / vs) ** 2))
        return f, f

    _dry(effect.at, stages, level)


def load_dependent_friction(effect: Effect, stages: Stages[Plant]) -> None:
    """-(Fc + Kl |load|) sgn v, load = actuator force times gear"""
    fc, kl = effect.number("coulomb"), effect.number("load_coefficient")
    _dry(effect.at, stages, lambda v, load: (fc + kl * load, fc + kl * load))


def asymmetric_friction(effect: Effect, stages: Stages[Plant]) -> None:
    """-(Fc+ + b+ v) forward (v > 0), +(Fc- + b- |v|) backward (v < 0)"""
    cf, cb, bf, bb = (
        effect.number(p)
        for p in ("coulomb_forward", "coulomb_backward", "viscous_forward", "viscous_backward")
    )
    _dry(effect.at, stages, lambda v, load: (cf + bf * max(v, 0.0), cb + bb * max(-v, 0.0)))


def _dry(joint: str, stages: Stages[Plant], level) -> None:
    def make(plant: Plant) -> DryFriction:
        share = LAWS[stages.law](plant, stages)

        def set_in(v: float, load: float) -> tuple[float, float]:
            forward, backward = level(v, load)
            part = share(v)
            return part * forward, part * backward

        return DryFriction(plant.dof(joint), set_in, plant.drivers(joint))

    stages.friction.append(make)


def _at_once(_plant: Plant, _stages: Stages[Plant]) -> Callable[[float], float]:
    return lambda _v: 1.0


def _creeping(_plant: Plant, _stages: Stages[Plant]) -> Callable[[float], float]:
    """tanh(|v| / v0): it never sticks."""
    return lambda v: math.tanh(abs(v) / CREEP)


def _sliding(plant: Plant, stages: Stages[Plant]) -> Callable[[float], float]:
    """1 - exp(-x / x0), x the way since the last reversal: bristles bend first."""
    way, forward = [0.0], [True]

    def share(v: float) -> float:
        if v != 0.0 and (v > 0.0) != forward[0]:
            way[0], forward[0] = 0.0, v > 0.0
        way[0] += abs(v) * plant.dt
        return -math.expm1(-way[0] / BRISTLE)

    stages.restart.append(lambda: way.__setitem__(0, 0.0))
    return share


LAWS = {"at once": _at_once, "creeping": _creeping, "after a way": _sliding}
"""Shares of its level with which dry friction acts. The vocabulary knows the first."""
