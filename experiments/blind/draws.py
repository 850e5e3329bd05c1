"""Random parameters for every effect, scaled by what the machine does; `size` 1 is a typical, visible effect."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from experiments.blind.models import Robot
from experiments.blind.statistics import Statistics
from experiments.blind.vocabulary import Effect

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


def _sign(rng: np.random.Generator, positive: float = 0.5) -> float:
    return 1.0 if rng.random() < positive else -1.0


def _steps(value: float, dt: float, low: float, high: float) -> float:
    return round(max(1, round(min(max(value, low), high) / dt)) * dt, 9)


def viscous_damping(p: Place, s: float) -> Parameters:
    return {"coefficient": s * 0.2 * p.torque / p.speed}


def coulomb_friction(p: Place, s: float) -> Parameters:
    return {"torque": s * 0.15 * p.torque}


def stribeck_friction(p: Place, s: float) -> Parameters:
    rng = p.rng()
    fc = s * 0.12 * p.torque
    return {
        "coulomb": fc,
        "static": fc * rng.uniform(1.6, 2.6),
        "velocity": rng.uniform(0.12, 0.35) * p.speed,
    }


def load_dependent_friction(p: Place, s: float) -> Parameters:
    rng = p.rng()
    return {"coulomb": s * 0.06 * p.torque, "load_coefficient": min(s**0.5 * rng.uniform(0.12, 0.3), 0.6)}


def asymmetric_friction(p: Place, s: float) -> Parameters:
    rng = p.rng()
    ratio, steep = rng.uniform(0.3, 0.6), rng.uniform(0.3, 0.6)
    coulomb, viscous = s * 0.15 * p.torque, s * 0.15 * p.torque / p.speed
    pair = (1.0, ratio) if rng.random() < 0.5 else (ratio, 1.0)
    slope = (1.0, steep) if rng.random() < 0.5 else (steep, 1.0)
    return {
        "coulomb_forward": coulomb * pair[0],
        "coulomb_backward": coulomb * pair[1],
        "viscous_forward": viscous * slope[0],
        "viscous_backward": viscous * slope[1],
    }


def quadratic_drag(p: Place, s: float) -> Parameters:
    if p.is_joint():
        return {"coefficient": s * 0.2 * p.torque / p.speed**2}
    return {"coefficient": s * 0.15 * p.stats.weight(p.at) / p.stats.body_speed(p.at) ** 2}


def joint_stiffness(p: Place, s: float) -> Parameters:
    rng, q = p.rng(), p.stats.position(p.at)
    reference = q.mean() + _sign(rng) * rng.uniform(0.4, 1.2) * q.std()
    return {"stiffness": s * 0.25 * p.torque / q.std(), "reference": float(reference)}


def cogging_torque(p: Place, s: float) -> Parameters:
    rng = p.rng()
    span = float(np.ptp(np.quantile(p.stats.position(p.at), [0.05, 0.95])))
    periods = float(rng.integers(int(np.ceil(9 / span)), int(np.ceil(20 / span)) + 1))
    return {"amplitude": s * 0.15 * p.torque, "periods": periods, "phase": rng.uniform(-np.pi, np.pi)}


def backlash(p: Place, s: float) -> Parameters:
    return {"gap": min(s * 0.02, 0.2)}


def joint_flexibility(p: Place, s: float) -> Parameters:
    rng = p.rng()
    rotor = float(p.stats.model.dof_armature[p.stats.dof(p.at)])
    stiffness = min(p.torque / (0.02 * s), rotor * 600.0**2)  # what the sub-step still resolves
    return {"stiffness": stiffness, "damping": 2 * rng.uniform(0.08, 0.25) * np.sqrt(stiffness * rotor)}


def armature(p: Place, s: float) -> Parameters:
    return {"inertia": s * 0.25 * p.stats.inertia(p.at)}


def actuator_gain(p: Place, s: float) -> Parameters:
    return {"gain": 1 + _sign(p.rng(), 0.3) * min(s * 0.15, 0.6)}


def dead_actuator(p: Place, s: float) -> Parameters:
    return {}


def actuator_bias(p: Place, s: float) -> Parameters:
    return {"bias": _sign(p.rng()) * s * 0.15 * p.force_rms}


def torque_saturation(p: Place, s: float) -> Parameters:
    share = min(max(1 - 0.12 * s, 0.4), 0.99)
    return {"limit": float(np.quantile(np.abs(p.stats.force(p.actuator)), share))}


def actuator_deadzone(p: Place, s: float) -> Parameters:
    return {"width": s * 0.12 * p.force_rms}


def actuator_delay(p: Place, s: float) -> Parameters:
    return {"delay": _steps(s * 0.015, p.dt, 0.002, 0.08)}


def actuator_lag(p: Place, s: float) -> Parameters:
    return {"time_constant": min(max(s * 0.02, 0.003), 0.12)}


def back_emf(p: Place, s: float) -> Parameters:
    joint = p.stats.model.joint(int(p.stats.model.actuator_trnid[p.actuator, 0])).name
    gain = p.stats.model.actuator_gainprm[p.actuator, 0]
    return {"coefficient": s * 0.2 * p.force_rms / gain / p.stats.speed(joint)}


def payload_mass(p: Place, s: float) -> Parameters:
    rng, model = p.rng(), p.stats.model
    centre = model.body_ipos[model.body(p.at).id].copy()
    reach = max(float(np.linalg.norm(centre)), 0.04)
    position = centre * rng.uniform(0.7, 1.9) + rng.uniform(0.2, 0.5) * reach * p.direction(rng)
    position[[i for i in range(3) if i not in p.robot.plane]] = 0.0
    return {"mass": s * 0.2 * p.stats.weight(p.at) / 9.81, "position": position.tolist()}


def mass_scale(p: Place, s: float) -> Parameters:
    return {"factor": 1 + _sign(p.rng(), 0.65) * min(s * 0.15, 0.5)}


def com_offset(p: Place, s: float) -> Parameters:
    rng, model = p.rng(), p.stats.model
    reach = max(float(np.linalg.norm(model.body_ipos[model.body(p.at).id])), 0.05)
    return {"offset": (min(s * 0.15, 0.8) * reach * p.direction(rng)).tolist()}


def gravity_tilt(p: Place, s: float) -> Parameters:
    rng = p.rng()
    angle, heading = min(s * 0.05, 0.3), rng.uniform(0, 2 * np.pi)
    axis = (
        [0.0, _sign(rng), 0.0]
        if p.robot.plane == (0, 2)
        else [float(np.cos(heading)), float(np.sin(heading)), 0.0]
    )
    return {"angle": angle, "axis": axis}


def external_force(p: Place, s: float) -> Parameters:
    return {"force": (s * 0.12 * p.stats.weight(p.at) * p.direction(p.rng())).tolist()}


def contact_friction(p: Place, s: float) -> Parameters:
    rng = p.rng()
    nominal = float(p.stats.model.geom_friction[:, 0].max())
    return {"mu": nominal * (max(1 - 0.2 * s, 0.15) if rng.random() < 0.7 else min(1 + 0.3 * s, 3.0))}


def contact_stiffness(p: Place, s: float) -> Parameters:
    return {"time_constant": 0.02 * (1 + min(s * 0.4, 4.0))}


def encoder_offset(p: Place, s: float) -> Parameters:
    return {"offset": _sign(p.rng()) * min(s * 0.05, 0.4)}


def sensor_delay(p: Place, s: float) -> Parameters:
    return {"delay": _steps(s * 0.012, p.dt, 0.002, 0.06)}


def cross_coupling(p: Place, s: float) -> Parameters:
    model, joint = p.stats.model, p.stats.model.joint(p.at).id
    other = joint + 1 if joint + 1 < model.njnt else joint - 1
    name = model.joint(other).name
    product = np.sqrt(((p.stats.position(name) * p.stats.qvel[:, p.stats.dof(name)]) ** 2).mean())
    return {"coefficient": s * 0.25 * p.torque / float(product), "other": float(other)}


def periodic_kick(p: Place, s: float) -> Parameters:
    rng = p.rng()
    return {"peak": s * 0.6 * p.torque, "period": rng.uniform(0.6, 1.3), "width": rng.uniform(0.05, 0.12)}


def hysteresis_spring(p: Place, s: float) -> Parameters:
    z0 = p.rng().uniform(0.15, 0.4) * float(p.stats.position(p.at).std())
    return {"stiffness": s * 0.2 * p.torque / z0, "yield": z0}


def speed_gravity(p: Place, s: float) -> Parameters:
    return {"coefficient": s * 0.2 * p.torque / p.speed**2, "phase": p.rng().uniform(-np.pi, np.pi)}


def rough_spot(p: Place, s: float) -> Parameters:
    rng, q = p.rng(), p.stats.position(p.at)
    return {
        "torque": s * 0.4 * p.torque,
        "centre": float(np.quantile(q, rng.uniform(0.3, 0.7))),
        "width": rng.uniform(0.15, 0.3) * float(q.std()),
    }


def position_damping(p: Place, s: float) -> Parameters:
    rng = p.rng()
    periods = 9 / float(np.ptp(np.quantile(p.stats.position(p.at), [0.05, 0.95])))
    return {
        "coefficient": s * 0.2 * p.torque / p.speed,
        "periods": periods,
        "phase": rng.uniform(-np.pi, np.pi),
    }


def gain_drift(p: Place, s: float) -> Parameters:
    rng = p.rng()
    return {"depth": min(s * 0.2, 0.8), "period": rng.uniform(2.0, 5.0), "phase": rng.uniform(-np.pi, np.pi)}


def dropout(p: Place, s: float) -> Parameters:
    rng = p.rng()
    width = min(max(s * 0.1, 0.04), 0.3)
    return {"width": width, "pause": rng.uniform(0.5, 1.0), "seed": float(rng.integers(1_000_000))}


DRAWS: dict[str, Callable[[Place, float], Parameters]] = {
    law.__name__: law
    for law in (
        viscous_damping,
        coulomb_friction,
        stribeck_friction,
        load_dependent_friction,
        asymmetric_friction,
        quadratic_drag,
        joint_stiffness,
        cogging_torque,
        backlash,
        joint_flexibility,
        armature,
        actuator_gain,
        dead_actuator,
        actuator_bias,
        torque_saturation,
        actuator_deadzone,
        actuator_delay,
        actuator_lag,
        back_emf,
        payload_mass,
        mass_scale,
        com_offset,
        gravity_tilt,
        external_force,
        contact_friction,
        contact_stiffness,
        encoder_offset,
        sensor_delay,
        cross_coupling,
        periodic_kick,
        hysteresis_spring,
        speed_gravity,
        rough_spot,
        position_damping,
        gain_drift,
        dropout,
    )
}


def draw(effect: str, place: Place, size: float, unknown: bool) -> Effect:
    """The effect at a place, of a size (1: typical); the same place gives the same random numbers."""
    if effect not in DRAWS:
        raise ValueError(f"no parameters are drawn for {effect!r}")
    parameters: Parameters = {
        name: [float(x) for x in value] if isinstance(value, list) else float(value)
        for name, value in DRAWS[effect](place, size).items()
    }
    return Effect(effect, place.at, parameters, unknown=unknown)
