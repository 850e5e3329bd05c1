"""Fits along valleys that are bent: straight steps out of them are led back."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Param
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.effects.inertia.rigid_body import add_point_mass
from mpge_jax.diagnosis.estimation import levenberg_marquardt
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.parameter_steps import Problem, corrected
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import fitted, search_of

MASS, DEPTH = 0.03, 0.9


def _valley(theta: np.ndarray) -> np.ndarray:
    """Rosenbrock's residuals [1, 2]: zero at (1, 1), small along y = x^2."""
    x, y = theta
    return np.array([[10 * (y - x**2), 1 - x]])


def _problem(theta: list[float]) -> Problem:
    free = [Param(name, "1", -100.0, 100.0, 1.0, prior=1e9) for name in "xy"]
    here = np.array(theta)
    f = Fitted(Hypothesis(), here, here, x=np.zeros(1))
    slopes = np.array([[[-20 * here[0], -1.0]], [[10.0, 0.0]]])
    return Problem(f, free, damping=1e-12, whitened=_valley(here), jacobian=slopes)


def test_a_straight_step_out_of_a_bent_valley_is_led_back_into_it():
    p = _problem([-1.0, 1.0])
    # to x = 1 along the tangent, y = 1 - 2 (1 + 1), of which the slopes say that nothing is left
    straight = np.array([1.0, -3.0])
    (back,) = corrected(p, straight, _valley(straight))
    np.testing.assert_allclose(back, [1.0, 1.0], atol=1e-6)


def test_what_slopes_foresee_needs_no_correction():
    p = _problem([-1.0, 1.0])
    straight = np.array([1.0, -3.0])
    foreseen = p.whitened + np.tensordot(straight - p.fit.theta, p.jacobian, 1)
    (again,) = corrected(p, straight, foreseen)
    np.testing.assert_allclose(again, straight, atol=1e-6)


def test_a_step_to_where_nothing_is_predicted_is_not_corrected():
    assert corrected(_problem([-1.0, 1.0]), np.array([1.0, -3.0]), np.array([[np.nan, 0.0]])) == []


def _loaded(model: mujoco.MjModel) -> None:
    fields = (model.body_mass[1], model.body_ipos[1], model.body_inertia[1], model.body_iquat[1])
    new = add_point_mass(np, *fields, np.array(MASS), np.array([0.0, 0.0, -DEPTH]))
    model.body_mass[1], model.body_ipos[1], model.body_inertia[1], model.body_iquat[1] = new


@pytest.mark.parametrize("led_back", [True, False])
def test_a_payload_far_from_its_start_is_reached_in_few_steps(led_back, monkeypatch):
    """Of a mass far out, moment and moment of inertia are known well, and it is known only by these."""
    if not led_back:
        monkeypatch.setattr(levenberg_marquardt, "corrected", lambda *_: [])
    s, _ = search_of(PENDULUM, record(PENDULUM, 0.8, change=_loaded, seconds=2.0))
    (payload,) = (t for t in s.terms if t.id == "payload_mass")
    white = s.whiten_one(fitted(s, {payload: [MASS, 0.0, 0.0, -DEPTH]}), s.train)
    start = fitted(s, {payload: [0.1, 0.0, 0.0, -0.3]})
    (f,) = levenberg_marquardt.fit(s.sim, [start], s.train, white, iterations=8)
    reached = f.theta[0] == pytest.approx(MASS, rel=0.03) and f.theta[3] == pytest.approx(-DEPTH, rel=0.03)
    assert reached == led_back
