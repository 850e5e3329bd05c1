"""Sizes of the effects in joints; `s` 1 is a typical, visible size."""

import numpy as np

from experiments.blind.draws.place import Parameters, Place, sign


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
    reference = q.mean() + sign(rng) * rng.uniform(0.4, 1.2) * q.std()
    return {"stiffness": s * 0.25 * p.torque / q.std(), "reference": float(reference)}


def cogging_torque(p: Place, s: float) -> Parameters:
    rng = p.rng()
    span = float(np.ptp(np.quantile(p.stats.position(p.at), [0.05, 0.95])))
    periods = float(rng.integers(int(np.ceil(9 / span)), int(np.ceil(20 / span)) + 1))
    return {"amplitude": s * 0.15 * p.torque, "periods": periods, "phase": rng.uniform(-np.pi, np.pi)}


def backlash(p: Place, s: float) -> Parameters:
    return {"gap": min(s * 0.02, 0.1)}


def joint_flexibility(p: Place, s: float) -> Parameters:
    rng = p.rng()
    rotor = float(p.stats.model.dof_armature[p.stats.dof(p.at)])
    stiffness = min(p.torque / (0.02 * s), rotor * 600.0**2)  # what the sub-step still resolves
    return {"stiffness": stiffness, "damping": 2 * rng.uniform(0.08, 0.25) * np.sqrt(stiffness * rotor)}


def armature(p: Place, s: float) -> Parameters:
    return {"inertia": s * 0.25 * p.stats.inertia(p.at)}
