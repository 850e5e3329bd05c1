"""Joints that move as recorded beside what nobody knows of them."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING as FITTED
from mpge_jax.diagnosis.estimation.whitening import robust_loss, whitener_beside
from mpge_jax.diagnosis.evidence.null_distribution import floor
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.guided import MOTIONS
from tests.diagnosis.machines import FINE_ARM, record
from tests.diagnosis.searches import prepared_of

NOTHING = Run(Hypothesis(), np.zeros(0))


def _kicks(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Torque at the shoulder that no model has: a sine of 3 Hz, and blows."""
    data.qfrc_applied[0] = 1.5 * np.sin(6 * np.pi * data.time) + (4.0 if data.time % 0.5 < 0.04 else 0.0)


@pytest.fixture(scope="module")
def kicked() -> Prepared:
    fine = FINE_ARM.replace('timestep="0.002"', 'timestep="0.0005"')
    return prepared_of(fine, record(fine, [1.0, 0.6], force=_kicks, noise=1e-5, rate=200))


@pytest.fixture(scope="module")
def guided(kicked) -> Prepared:
    return kicked.guiding(0)


def _elbow(p: Prepared, run: Run = NOTHING) -> np.ndarray:
    return p.sim.residuals([run], p.windows("train", 0.25, 12))[0][..., 1]


def test_others_feel_the_motion_of_a_guided_joint_and_nothing_that_acts_on_it(kicked, guided):
    free, held = np.nanstd(_elbow(kicked)), np.nanstd(_elbow(guided))
    assert free > 0.02 and held < 0.02 * free


def test_what_acts_at_the_others_is_told_as_ever(guided):
    """Friction of 0.05 N m at the elbow, which it does not have, moves it by far more than anything else does."""
    run = Run(Hypothesis.of(Term("coulomb_friction", Place("joint", "elbow", 1))), np.array([0.05]))
    assert np.nanstd(_elbow(guided, run)) > 5 * np.nanstd(_elbow(guided))
    shoulder = Run(Hypothesis.of(Term("coulomb_friction", Place("joint", "shoulder", 0))), np.array([0.3]))
    np.testing.assert_allclose(_elbow(guided, shoulder), _elbow(guided), atol=2e-5)


def test_effects_with_a_memory_act_beside_a_guide(guided):
    """Friction that is computed step by step leaves a guided joint where it is."""
    run = Run(
        Hypothesis.of(Term("stribeck_friction", Place("joint", "shoulder", 0))), np.array([0.2, 0.3, 0.1])
    )
    np.testing.assert_allclose(_elbow(guided, run), _elbow(guided), atol=2e-5)


def test_a_guided_joint_counts_as_unmeasured(kicked, guided):
    w = guided.windows("train", 0.25, 12)
    residual = guided.sim.residuals([NOTHING], w)[0]
    assert np.isnan(residual[..., [0, 2]]).all() and np.isfinite(residual[..., 1]).any()
    assert np.isfinite(kicked.train[0].recording.qpos).all() and kicked.sim.guided == ()


def test_warnings_of_a_guided_machine_are_its_own(kicked):
    kicked.warnings[:] = ["one"]
    guided = kicked.guiding(0)
    guided.warnings.append("two")
    assert kicked.warnings == ["one"]


def test_what_noise_leaves_of_the_others_is_told_with_the_guided_motion(guided):
    """Nothing is missing at the elbow. What is left there is what measurements leave open of the shoulder's motion, of
    its blows above all: a model that is true leaves as much."""
    noise, w = floor(guided, FITTED, 0.25), guided.windows("train", 0.25, 40)
    white = whitener_beside(guided.sim, FITTED.hypothesis, FITTED.theta, w, guided.noise, temper=False)
    left = robust_loss(white.excess(white(guided.sim.residuals([NOTHING], w)[0])))
    assert 0.5 * left.mean() < noise.loss < 2.0 * left.mean() and left.mean() > 2.0
    assert not noise.exceeded(left)


def test_what_is_not_known_of_the_guided_motion_is_seen_past(guided):
    """Blows at the shoulder shake the elbow by more than noise, and not otherwise than the shoulder may have moved."""
    w = guided.windows("train", 0.25, 40)
    assert len(w.otherwise()) == MOTIONS
    blind = replace(w, sources=tuple(replace(s, otherwise=()) for s in w.sources))
    losses = []
    for windows in (w, blind):
        white = whitener_beside(
            guided.sim, FITTED.hypothesis, FITTED.theta, windows, guided.noise, temper=False
        )
        losses.append(robust_loss(white.excess(white(guided.sim.residuals([NOTHING], windows)[0]))).mean())
    assert losses[0] < 0.7 * losses[1]


def test_states_as_measured_are_as_well_known_as_that(kicked):
    direct = replace(kicked, noise=replace(kicked.noise, direct=True)).guiding(0)
    assert all(s.otherwise == () for s in direct.sources)
