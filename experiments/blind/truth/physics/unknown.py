"""Physics that the vocabulary does not contain. A good diagnosis says `unexplained`, and where."""

import math

import numpy as np

from experiments.blind.truth.plant import Plant
from experiments.blind.truth.stages import DryFriction, Stages
from experiments.blind.vocabulary import Effect


def cross_coupling(effect: Effect, stages: Stages[Plant]) -> None:
    """c q_o v_o at this joint, from the motion of another joint o (`joint` parameter is its index)."""
    c, other = effect.number("coefficient"), int(effect.number("other"))

    def add(plant: Plant, extra: np.ndarray) -> None:
        q, v = plant.data.qpos[plant.qpos_of[other]], plant.data.qvel[plant.dof_of[other]]
        extra[plant.dof(effect.at)] += c * q * v

    stages.joint.append(add)


def periodic_kick(effect: Effect, stages: Stages[Plant]) -> None:
    """A half-sine of torque every `period` seconds."""
    peak, period, width = (effect.number(p) for p in ("peak", "period", "width"))

    def add(plant: Plant, extra: np.ndarray) -> None:
        t = plant.data.time % period
        if t < width:
            extra[plant.dof(effect.at)] += peak * math.sin(math.pi * t / width)

    stages.joint.append(add)


def gain_drift(effect: Effect, stages: Stages[Plant]) -> None:
    """The actuator's gain falls and recovers with time (a motor that heats up and cools down)."""
    depth, period, phase = (effect.number(p) for p in ("depth", "period", "phase"))

    def stage(plant: Plant, force: np.ndarray) -> np.ndarray:
        force = force.copy()
        swing = math.sin(2 * math.pi * plant.data.time / period + phase)
        force[plant.actuator(effect.at)] *= 1 + depth * swing
        return force

    stages.force.append(stage)


def dropout(effect: Effect, stages: Stages[Plant]) -> None:
    """The actuator loses its force for a moment, at times that nothing else predicts."""
    width, pause, seed = effect.number("width"), effect.number("pause"), int(effect.number("seed"))
    gaps = np.random.default_rng(seed).exponential(pause, 400) + width
    starts = np.cumsum(gaps)

    def stage(plant: Plant, force: np.ndarray) -> np.ndarray:
        t = plant.data.time
        i = int(np.searchsorted(starts, t, side="right")) - 1
        if i >= 0 and t - starts[i] < width:
            force = force.copy()
            force[plant.actuator(effect.at)] = 0.0
        return force

    stages.force.append(stage)


def hysteresis_spring(effect: Effect, stages: Stages[Plant]) -> None:
    """Bouc-Wen: torque -k z, dz/dt = v (1 - (|z| / z0)^2 (sgn(v z) + 1) / 2): a spring that yields and remembers."""
    k, z0 = effect.number("stiffness"), effect.number("yield")
    state = [0.0]

    def add(plant: Plant, extra: np.ndarray) -> None:
        v, z = plant.v(effect.at), state[0]
        pulling = 1.0 if v * z > 0 else 0.0
        state[0] = z + plant.dt * v * (1 - (abs(z) / z0) ** 2 * pulling)
        extra[plant.dof(effect.at)] -= k * state[0]

    stages.joint.append(add)
    stages.restart.append(lambda: state.__setitem__(0, 0.0))


def speed_gravity(effect: Effect, stages: Stages[Plant]) -> None:
    """c v^2 sin(q + phase): looks like gravity, but grows with the joint's own speed."""
    c, phase = effect.number("coefficient"), effect.number("phase")

    def add(plant: Plant, extra: np.ndarray) -> None:
        extra[plant.dof(effect.at)] += c * plant.v(effect.at) ** 2 * math.sin(plant.q(effect.at) + phase)

    stages.joint.append(add)


def rough_spot(effect: Effect, stages: Stages[Plant]) -> None:
    """Dry friction on a stretch of the travel only (a dented bearing)."""
    torque, centre, width = (effect.number(p) for p in ("torque", "centre", "width"))
    joint = effect.at

    def make(plant: Plant) -> DryFriction:
        def level(v: float, load: float) -> tuple[float, float]:
            f = torque * math.exp(-(((plant.q(joint) - centre) / width) ** 2))
            return f, f

        return DryFriction(plant.dof(joint), level, [])

    stages.friction.append(make)


def position_damping(effect: Effect, stages: Stages[Plant]) -> None:
    """-b (1 + cos(n q + phase)) v: a damper that grips and lets go along the travel."""
    b, n, phase = (effect.number(p) for p in ("coefficient", "periods", "phase"))

    def add(plant: Plant, extra: np.ndarray) -> None:
        q, v = plant.q(effect.at), plant.v(effect.at)
        extra[plant.dof(effect.at)] -= b * (1 + math.cos(n * q + phase)) * v

    stages.joint.append(add)


UNKNOWN = {
    f.__name__: f
    for f in (
        cross_coupling,
        periodic_kick,
        gain_drift,
        dropout,
        hysteresis_spring,
        speed_gravity,
        rough_spot,
        position_damping,
    )
}
