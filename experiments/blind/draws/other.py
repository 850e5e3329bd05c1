"""Sizes of the effects in actuators, masses, gravity, contacts and sensors; `s` 1 is typical."""

import numpy as np

from experiments.blind.draws.place import Parameters, Place, sign, whole_steps


def actuator_gain(p: Place, s: float) -> Parameters:
    return {"gain": 1 + sign(p.rng(), 0.3) * min(s * 0.15, 0.6)}


def dead_actuator(p: Place, s: float) -> Parameters:
    return {}


def actuator_bias(p: Place, s: float) -> Parameters:
    return {"bias": sign(p.rng()) * s * 0.15 * p.force_rms}


def torque_saturation(p: Place, s: float) -> Parameters:
    share = min(max(1 - 0.12 * s, 0.4), 0.99)
    return {"limit": float(np.quantile(np.abs(p.stats.force(p.actuator)), share))}


def actuator_deadzone(p: Place, s: float) -> Parameters:
    return {"width": s * 0.12 * p.force_rms}


def actuator_delay(p: Place, s: float) -> Parameters:
    return {"delay": whole_steps(s * 0.015, p.dt, 0.002, 0.08)}


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
    return {"factor": 1 + sign(p.rng(), 0.65) * min(s * 0.15, 0.5)}


def com_offset(p: Place, s: float) -> Parameters:
    rng, model = p.rng(), p.stats.model
    reach = max(float(np.linalg.norm(model.body_ipos[model.body(p.at).id])), 0.05)
    return {"offset": (min(s * 0.15, 0.8) * reach * p.direction(rng)).tolist()}


def gravity_tilt(p: Place, s: float) -> Parameters:
    rng = p.rng()
    angle, heading = min(s * 0.05, 0.3), rng.uniform(0, 2 * np.pi)
    axis = (
        [0.0, sign(rng), 0.0]
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
    return {"offset": sign(p.rng()) * min(s * 0.05, 0.4)}


def sensor_delay(p: Place, s: float) -> Parameters:
    return {"delay": whole_steps(s * 0.012, p.dt, 0.002, 0.06)}
