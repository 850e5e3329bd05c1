"""What a law of friction reads at a step, at a speed."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.step import Step
from mpge_jax.diagnosis.simulation.single_step import Machine, observe


def at_speed(
    machine: Machine, speed: float, command: float = 0.0, inertia: float = 1.0, dt: float = 1e-3
) -> Step:
    """One joint with one motor, at 0 rad or m."""
    zero, still = np.zeros(1), np.zeros(3)
    v, u = np.array([speed]), np.array([command])
    return observe(np, machine, zero, v, u, lambda _: still, zero, dt, zero, lambda _: inertia)
