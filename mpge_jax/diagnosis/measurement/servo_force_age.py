"""How old a servo's force is when it acts: the servo computes it from the motion in steps of its own, and holds it.

At a row the measured force is that of the motion there. Between rows a servo that computes in steps of T applies, on
average, the force of T/2 ago (a simulated one too, T its timestep). Taken as immediate, that force brakes more than it
did: every joint seems to have less damping than the model, in proportion to its servo's stiffness.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.missing_force import excess_by_dof
from mpge_jax.diagnosis.estimation.whitening import whitener
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
FEWEST_SERVOS = 3
"""Servos that it takes to tell their common age from what is missing at single joints."""
EXPLAINED, AGREEMENT = 0.3, 0.75
"""Share of the missing force that an age must explain at a servo, and how near the ages of several must lie."""
WINDOWS = 40
OTHER = 0.25
"""Share by which an age differs from another one."""


def aged(p: Prepared, servos: Sequence[int], age: float) -> Prepared:
    """The same where the measured forces of these actuators act `age` (s) late."""
    ages = np.zeros(p.measured.size)
    ages[list(servos)] = age
    return p.mapped(lambda s: s.rebuilt(age=ages))


def age_of(p: Prepared, servos: Sequence[int]) -> float:
    """The age (s) with which the forces of these actuators are read."""
    return max((float(p.train[0].age[a]) for a in servos), default=0.0)


def describe_age(age: float) -> str:
    """A warning."""
    return (
        f"the servos' measured forces act {1e3 * age:.2g} ms late, as those of servos that compute in steps "
        "and hold their force; this is taken into account and is no missing physics."
    )


def other_age(p: Prepared, servos: Sequence[int], f: Fitted) -> float | None:
    """The age (s) of these forces if `f` is true, where it is clearly another one than they are read with."""
    now, age = age_of(p, servos), staleness(aged(p, servos, 0.0), servos, f)
    return age if age and abs(age - now) > OTHER * max(age, now) else None


def staleness(p: Prepared, servos: Sequence[int], f: Fitted = NOTHING) -> float:
    """Age (s) of the forces of these actuators [on joints, measured], 0 to half the time between rows, if `f` is true.

    The missing force of every window goes with the rate at which the measured force changes, times the age. It counts
    where that explains what is missing at half of the servos or more, with nearly the same age; else it is 0, as
    something else is missing. It is the age at the windows' own timestep, with what integrating in such steps adds.
    """
    if len(servos) < FEWEST_SERVOS:
        return 0.0
    w = p.windows("train", p.config.decide_s, WINDOWS, seed=9)
    if w.count < 4:
        return 0.0
    white = whitener(p.sim, f.hypothesis, f.theta, w, p.noise, temper=False)
    _, missing = excess_by_dof(p.sim, f, w, white)
    ages = []
    for a in servos:
        joint = int(p.model.actuator_trnid[a, 0])
        force = missing[:, p.model.jnt_dofadr[joint]] / p.model.actuator_gear[a, 0]
        rate = _rates(w, a)
        age = -float(force @ rate / max(rate @ rate, 1e-300))
        left = float(((force + age * rate) ** 2).sum() / max((force**2).sum(), 1e-300))
        if age > 0.0 and 1.0 - left > EXPLAINED:
            ages.append(age)
    if len(ages) < max(2, len(servos) / 2) or np.ptp(ages) > AGREEMENT * np.median(ages):
        return 0.0
    return float(min(np.median(ages), 0.5 * p.ctx.period))


def _rates(w: Windows, a: int) -> Array:
    """Rate [W] at which the smooth part of a measured force changes over each window."""
    out = []
    for source, start, length in zip(w.source, w.start, w.times.max(1), strict=True):
        s = w.sources[source]
        ends = np.interp([start, start + length], s.recording.time, s.smooth[:, a])
        out.append((ends[1] - ends[0]) / length)
    return np.array(out)
