"""Machines without actuators: what acts at joints and bodies is the same as where a motor is there and does nothing."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.effects.residual.axis import LOAD, Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import prepared_of

UNDRIVEN = (
    PENDULUM[: PENDULUM.index("<actuator")] + PENDULUM[PENDULUM.index("</actuator>") + len("</actuator>") :]
)
HINGE, LOADED = Place("joint", "hinge", 0), Residual((Axis(LOAD, -1.0, 1.0),), 9.0).id


@pytest.fixture(scope="module")
def machines():
    """The same swings from rest, with a motor that is told nothing and without one."""
    runs = record(PENDULUM, 0.0, count=2)
    with_motor = prepared_of(PENDULUM, runs)
    without = prepared_of(UNDRIVEN, [r.__class__(r.name, r.time, r.qpos) for r in runs])
    return with_motor, without


@pytest.mark.parametrize(
    "effect", ["coulomb_friction", "load_dependent_friction", "quadratic_drag", "armature", LOADED]
)
def test_effects_of_joints_act_alike(machines, effect):
    assert REGISTRY[effect] is not None
    moved = []
    for p in machines:
        w = p.windows("train", 0.25, 4)
        h = Hypothesis.of(Term(effect, HINGE))
        (term,) = h.terms
        start = np.asarray(term.effect.starts(p.ctx, HINGE))[0]
        theta = np.full(start.shape, 0.05) if effect == LOADED else start
        none, there = p.sim.residuals([Run(Hypothesis(), np.zeros(0)), Run(h, theta)], w)
        moved.append((there - none)[..., 0])
    assert np.abs(moved[0]).max() > 1e-5
    np.testing.assert_allclose(moved[1], moved[0], rtol=1e-6, atol=1e-9)
