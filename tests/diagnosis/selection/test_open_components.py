"""Components of a vector that recordings do not tell are reported as nothing."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.selection.backward_elimination import without_open_components
from mpge_jax.diagnosis.selection.search_state import Search
from tests.diagnosis.machines import FINE_ARM, record
from tests.diagnosis.searches import search_of

TILT, ANGLE, SIDEWAYS = Term("gravity_tilt", Place("world", "world", 0)), 0.06, 0.02


@pytest.fixture(scope="module")
def planar() -> tuple[Search, np.ndarray]:
    """An arm whose joints all turn about y, tilted about that, and the tilt that is told, with some about x, of which
    they tell next to nothing."""

    def tilted(model: mujoco.MjModel) -> None:
        model.opt.gravity[:] = 9.81 * np.array([np.sin(ANGLE), 0.0, -np.cos(ANGLE)])

    s = search_of(FINE_ARM, record(FINE_ARM, 0.8, change=tilted, count=4))[0]
    axes = np.array([TILT.effect.report(s.sim.ctx, TILT.place, x)["axis"] for x in np.eye(2)])
    return s, axes @ np.array([SIDEWAYS, -ANGLE, 0.0])


def _told(theta: np.ndarray, deviations: np.ndarray) -> Fitted:
    return Fitted(Hypothesis.of(TILT), theta, np.zeros(2), cov=np.diag(deviations**2))


def test_gravity_is_not_tilted_sideways_where_nothing_turns_so(planar):
    s, theta = planar
    about_y = np.abs(theta) > 1.5 * SIDEWAYS
    f = _told(theta, np.where(about_y, 0.001, 0.02))
    told = without_open_components(s, f)
    report = TILT.effect.report(s.sim.ctx, TILT.place, told.theta)
    np.testing.assert_allclose(report["axis"], [0.0, -1.0, 0.0], atol=1e-12)
    assert report["angle"] == pytest.approx(ANGLE)
    np.testing.assert_array_equal(told.cov, f.cov)


def test_what_goes_leaves_the_others_where_they_are_best_without_it(planar):
    s, theta = planar
    about_y = np.abs(theta) > 1.5 * SIDEWAYS
    f = _told(theta, np.where(about_y, 0.001, 0.02))
    correlated = Fitted(f.hypothesis, theta, f.centre, cov=f.cov + 0.5 * 0.001 * 0.02 * (1 - np.eye(2)))
    moved = without_open_components(s, correlated).theta - theta
    sideways, own = moved[~about_y][0], moved[about_y][0]
    assert own == pytest.approx(0.5 * 0.001 / 0.02 * sideways)


def test_what_is_known_of_a_vector_stays(planar):
    s, theta = planar
    known = _told(theta, np.full(2, 0.001))
    assert without_open_components(s, known) is known


def test_what_is_missed_stays(planar):
    """By these intervals the tilt that is there is the one that may be none."""
    s, theta = planar
    wrong = _told(theta, np.where(np.abs(theta) > 1.5 * SIDEWAYS, 1.0, 0.001))
    assert without_open_components(s, wrong) is wrong
