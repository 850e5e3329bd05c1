"""How old a servo's force is when it acts: the servo computes it from the motion in steps of its own, and holds it.

At a row the measured force is that of the motion there. Between rows a servo that computes in steps of T applies, on
average, the force of T/2 ago (a simulated one too, T its timestep). Held against forces taken as immediate, that looks
like a damping of stiffness times T/2 that every joint lacks.
"""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.fit import Fitted
from mpge_jax.diagnosis.hypothesis import Hypothesis
from mpge_jax.diagnosis.prepare import Prepared
from mpge_jax.diagnosis.verdict import excess_by_dof
from mpge_jax.diagnosis.whiten import whitener

Array = np.ndarray
FEWEST = 3
"""Servos that it takes to tell their common age from what is missing at single joints."""
WINDOWS = 40


def staleness(p: Prepared, following: list[int]) -> float:
    """Age (s) of the forces of these actuators [on joints, measured], 0 to half the time between rows.

    The missing force of every window goes with the rate at which the measured force changes, times the age. Its
    median over the servos is theirs in common; what is missing at one joint says nothing about it. It is the age at
    the windows' own timestep, with what integrating in such steps adds.
    """
    if len(following) < FEWEST:
        return 0.0
    w = p.windows(False, p.config.decide_s, WINDOWS, seed=9)
    if w.count < 2:
        return 0.0
    nominal = Fitted(Hypothesis(), np.zeros(0), np.zeros(0))
    white = whitener(p.sim, nominal.hypothesis, nominal.theta, w, p.noise, temper=False)
    _, missing = excess_by_dof(p.sim, nominal, w, white)
    length = w.times.max(1)
    ages = []
    for a in following:
        smooth = [s.smooth[:, a] for s in w.sources]
        rate = np.array(
            [
                np.diff(np.interp([t, t + d], w.sources[s].recording.time, smooth[s]))[0] / d
                for s, t, d in zip(w.source, w.start, length, strict=True)
            ]
        )
        joint = int(p.model.actuator_trnid[a, 0])
        force = missing[:, p.model.jnt_dofadr[joint]] / p.model.actuator_gear[a, 0]
        ages.append(-float(force @ rate / max(rate @ rate, 1e-300)))
    return float(np.clip(np.median(ages), 0.0, 0.5 * p.ctx.period))
