"""Sizes of the physics outside the vocabulary; `s` 1 is a typical, visible size."""

import numpy as np

from experiments.blind.draws.place import Parameters, Place


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
