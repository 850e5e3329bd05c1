"""Errors on held-out recordings."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis.estimation.prediction_error import Errors, MeanSquare
from mpge_jax.diagnosis.evidence.held_out_error import FitReport, fit_report
from tests.diagnosis.searches import COULOMB, fitted


def test_noise_is_told_as_it_was_estimated_also_where_less_is_left(rubbing):
    s, p = rubbing
    report = fit_report(p, fitted(s, {COULOMB: [0.1]}), "test")
    louder = report.above(100.0)
    assert louder.floor == pytest.approx(100.0 * report.floor) and louder.floor > louder.after.rms
    assert louder.left(rugged=False) == 0.0


def test_floors_of_windows_and_joints_by_hand():
    """Two windows and two joints, of which the second one's noise is twice the first one's."""
    before, after = (
        Errors(1.0, np.array(x), np.ones(2), np.zeros((2, 1, 2))) for x in ([5.0, 13.0], [0.3, 1.3])
    )
    plain = FitReport(
        None, before, after, np.array([3.0, 4.0]), 5.0, np.array([0.1, 0.2]), np.full(2, np.inf)
    )
    twice = plain.above(2.0)
    np.testing.assert_allclose([*twice.floors, twice.floor, *twice.joint_floors], [6.0, 8.0, 10.0, 0.2, 0.4])
    more = plain.beside(MeanSquare(np.array([16.0, 0.0]), np.array([0.03, 0.0])))
    np.testing.assert_allclose(more.floors, [5.0, 4.0])
    np.testing.assert_allclose([more.floor, *more.joint_floors], [np.sqrt(33.0), 0.2, 0.2])
    first, second = np.array([True, False]), np.array([False, True])
    assert plain.left_at(first) == pytest.approx((0.09 - 0.01) / (25.0 - 0.01))
    assert plain.left_at(second) == pytest.approx((1.69 - 0.04) / (169.0 - 0.04))
    # what noise may leave is nothing
    assert more.left_at(first) == 0.0 and plain.left_at(np.zeros(2, bool)) == 0.0
