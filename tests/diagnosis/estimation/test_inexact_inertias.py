"""What parameters are uncertain by where the given masses and inertias may be off."""

import numpy as np

from mpge_jax.diagnosis.effects.inertia.given import given_inertias
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.inexact_inertias import beside_inexact_inertias
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import GAIN, fitted, search_of

FREE = PENDULUM.replace('damping="0.02" armature="0.004"', "")


def test_a_gain_is_known_no_better_than_the_mass_that_it_moves():
    def weaker(model):
        model.actuator_gear[0, 0] = 0.8

    s, _ = search_of(FREE, record(FREE, 0.8, change=weaker))
    white = s.whiten(fitted(s, {GAIN: [0.8]}))[0]
    found = fit(s.sim, [fitted(s, {GAIN: [0.8]})], s.train, white)[0]
    same = beside_inexact_inertias(s.sim, found, s.train, white, 0.0)
    assert same is found and np.sqrt(same.cov[0, 0]) < 0.002
    # gain, mass and inertia are known up to one factor: the mean of two factors of deviation 0.03 each
    wider = beside_inexact_inertias(s.sim, found, s.train, white, 0.03)
    np.testing.assert_allclose(np.sqrt(wider.cov[0, 0]) / 0.8, 0.03 / np.sqrt(2), rtol=0.05)
    assert wider.theta is found.theta and wider.hypothesis == found.hypothesis
    assert beside_inexact_inertias(s.sim, NOTHING, s.train, white, 0.03) is NOTHING
    both = fit(s.sim, [fitted(s, {GAIN: [0.8], given_inertias(0.03): [1.0, 1.0]})], s.train, white)[0]
    assert beside_inexact_inertias(s.sim, both, s.train, white, 0.03) is both


def test_an_interval_reaches_what_would_be_found_with_the_true_masses():
    """Damping and rotor inertia are as given, and tell that the link is heavier and its motor as strong as it was."""

    def heavier(model):
        model.body_mass[1] *= 1.05
        model.body_inertia[1] *= 1.05

    s, _ = search_of(PENDULUM, record(PENDULUM, 0.8, change=heavier))
    white = s.whiten(fitted(s, {GAIN: [0.95]}))[0]
    found = fit(s.sim, [fitted(s, {GAIN: [0.95]})], s.train, white)[0]
    wider = beside_inexact_inertias(s.sim, found, s.train, white, 0.03)
    missed = 1.0 - found.theta[0]
    assert missed > 0.03 and 1.96 * np.sqrt(found.cov[0, 0]) < missed < 1.96 * np.sqrt(wider.cov[0, 0])
