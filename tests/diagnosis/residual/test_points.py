"""Points beside a fitted function are the force that was planted, told from recordings that nothing was fitted to."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np

from mpge_jax.diagnosis import Config
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.force_balance.force_errors import force_errors
from mpge_jax.diagnosis.force_balance.tracks import Resolution
from mpge_jax.diagnosis.residual.model import Function
from mpge_jax.diagnosis.residual.points import MOST, missing_in_forces, missing_in_motion
from tests.diagnosis.machines import FINE_PENDULUM, record
from tests.diagnosis.searches import COULOMB, HINGE, fitted, prepared_of, search_of
from tests.diagnosis.verdict.test_forces_given import MOTORS, bench

SLOW = 1.0
"""Speed (rad/s) below which the direction of dry friction changes within a piece."""


def of(place: Place, *axes: Axis, size: float = 0.1) -> Function:
    """A function whose values rise from -size to size."""
    effect = Residual(axes, 5.0)
    return Function(Term(effect.id, place), np.linspace(-size, size, effect.size), None)


def test_a_motion_shows_the_force_that_its_model_lacks():
    def drag(_model, data):
        data.qfrc_applied[0] = -0.03 * data.qvel[0] * np.abs(data.qvel[0])

    p = prepared_of(FINE_PENDULUM, record(FINE_PENDULUM, 1.0, force=drag, seconds=2.5))
    points = missing_in_motion(p, NOTHING, of(HINGE, Axis("v", -4.0, 4.0), size=0.5))
    (v,) = points.inputs
    assert points.force.size > 20 and np.ptp(v) > 4.0
    planted = -0.03 * v * np.abs(v)
    assert np.median(np.abs(points.force - planted)) < 0.01 and np.abs(planted).max() > 0.2
    assert np.corrcoef(points.force, planted)[0, 1] > 0.99


def test_what_is_named_is_not_missing(rubbing_finely):
    s, p = rubbing_finely
    function = of(HINGE, Axis("v", -3.0, 3.0))
    for fit, left in ((NOTHING, 0.1), (fitted(s, {COULOMB: [0.1]}), 0.0)):
        points = missing_in_motion(p, fit, function)
        fast = np.abs(points.inputs[0]) > SLOW
        assert fast.sum() > 5
        missing = -points.force[fast] * np.sign(points.inputs[0][fast])
        # it turns within the last piece
        np.testing.assert_allclose(np.sort(missing)[1:], left, atol=0.005)


def test_measured_forces_show_what_the_motion_does_not_explain():
    def odd(q, v):
        return np.stack([0 * q[:, 0], 0.4 * v[:, 1] * np.cos(3 * q[:, 1])], 1)

    geared = MOTORS.replace('name="elbow_motor" joint="elbow"', 'name="elbow_motor" joint="elbow" gear="5"')
    p = prepare(
        mujoco.MjSpec.from_string(geared),
        bench(geared, [("actuator_gain", "elbow_motor", [0.5])], 1e-3, odd),
        Config(jobs=1),
    )
    f = fitted(
        SimpleNamespace(sim=p.sim), {Term("actuator_gain", Place("actuator", "elbow_motor", 1)): [0.5]}
    )
    held = force_errors(p, p.test, Resolution(), f)
    function = of(Place("joint", "elbow", 1), Axis("q", -1.0, 1.0), Axis("v", -4.0, 4.0))
    points = missing_in_forces(p, f, held, function)
    q, v = points.inputs
    assert 100 < points.force.size <= MOST
    # the motor showed so much more than the motion needs, 2.5 times that at the joint: so much acts against it
    np.testing.assert_allclose(points.force, -2.5 * 0.4 * v * np.cos(3 * q), atol=0.1)


def test_slight_forces_are_told_over_longer_pieces():
    recordings = record(FINE_PENDULUM, 1.0, seconds=2.5, noise=2e-3)
    _, p = search_of(FINE_PENDULUM, recordings)
    strong, weak = (
        missing_in_motion(p, NOTHING, of(HINGE, Axis("v", -4.0, 4.0), size=size)).force.size
        for size in (100.0, 1e-3)
    )
    assert strong > 2 * weak > 0
