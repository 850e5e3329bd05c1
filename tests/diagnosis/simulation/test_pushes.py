"""A push acts in the steps of its part of a window, and in no other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.candidates import all_terms
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.simulation.batch_simulator import BY_THE_ENGINE, STEP_BY_STEP, Run
from mpge_jax.diagnosis.simulation.pushes import Push, by_step
from tests.diagnosis.machines import record
from tests.diagnosis.searches import prepared_of

SLIDE = """
<mujoco><option timestep="0.01" gravity="0 0 0"/><worldbody><body name="cart">
<joint name="hinge" type="slide" axis="1 0 0"/><geom type="box" size=".1 .1 .1" mass="2"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>
"""


def test_pushes_by_the_step_from_which_on_they_act():
    told = by_step([(Push(1, 3.0, 0.25, 0.5), np.array([0])), (Push(0, 2.0), np.array([1]))], 2, 2, 8)
    assert list(told) == [0, 2, 4]
    np.testing.assert_array_equal(told[0], [[0.0, 0.0], [2.0, 0.0]])
    np.testing.assert_array_equal(told[2], [[0.0, 3.0], [2.0, 0.0]])
    np.testing.assert_array_equal(told[4], told[0])
    # at the end nothing changes any more, and without any nothing acts
    assert list(by_step([(Push(0, 1.0, 0.5, 1.0), np.array([0]))], 1, 1, 4)) == [0, 2]
    np.testing.assert_array_equal(by_step([], 3, 2, 4)[0], np.zeros((3, 2)))


@pytest.mark.parametrize("steps", [7, 12, 20, 125])
def test_one_after_the_other_they_push_in_every_step_once(steps):
    edges = np.linspace(0.0, 1.0, 21).tolist()
    pushes = [Push(0, 1.0, *part) for part in pairwise(edges)]
    told = by_step([(push, np.array([k])) for k, push in enumerate(pushes)], 20, 1, steps)
    along = [told[max(k for k in told if k <= step)] for step in range(steps)]
    np.testing.assert_array_equal(np.sum(along, 1), 1.0)


@pytest.mark.parametrize("way", [BY_THE_ENGINE, STEP_BY_STEP])
def test_a_cart_keeps_the_speed_that_a_push_gave_it(way):
    """3 N on 2 kg from the second to the third fifth of a window."""
    p = prepared_of(SLIDE, record(SLIDE, 1.0, seconds=1.0))
    sim, w = p.sim, p.windows("train", p.config.decide_s, 3)
    if way == STEP_BY_STEP:
        load = next(t for t in all_terms(p.ctx) if t.name == "external_force")
        sim = sim.beside(Hypothesis.of(load), np.zeros(len(load.params(p.ctx))))
    runs = [Run(Hypothesis(), np.zeros(0), push=push) for push in (None, Push(0, 3.0, 0.2, 0.6))]
    assert {sim._way(run) for run in runs} == {way}
    alone, pushed = sim.residuals(runs, w)
    steps = np.arange(w.steps)
    acts = (steps >= round(0.2 * w.steps)) & (steps < round(0.6 * w.steps))
    # semi-implicit steps: a speed acts in the step that changes it
    moved = np.concatenate([[0.0], np.cumsum(np.cumsum(1.5 * w.dt * acts)) * w.dt])
    gained = moved[np.round(w.times / w.dt).astype(int)]
    np.testing.assert_allclose((pushed - alone)[..., 0], -gained, atol=1e-9)
