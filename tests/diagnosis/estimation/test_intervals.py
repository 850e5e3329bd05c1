"""Reported values with their intervals, and as words."""

import dataclasses

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.intervals import parameters
from mpge_jax.diagnosis.estimation.quantities import quantity
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import HINGE, prepared_of

WITHIN = 1.959964


@pytest.fixture(scope="module")
def ctx():
    return prepared_of(PENDULUM, record(PENDULUM, 0.8, count=4, seconds=1.0)).ctx


def _told(ctx, effect: str, theta: list[float], deviation: list[float]) -> dict:
    f = Fitted(Hypothesis.of(Term(effect, HINGE)), np.array(theta), np.array(theta))
    return parameters(ctx, dataclasses.replace(f, cov=np.diag(np.square(deviation))), f.hypothesis.terms[0])


def test_what_follows_from_one_parameter_lies_between_the_ends_of_its_interval(ctx):
    """Bristles that bend by 1/100, with a deviation of a fifth or four fifths of that: a stiffness is no linear matter
    of it, and no less than nothing."""
    told = _told(ctx, "coulomb_friction:elastic", [0.5, 0.01, 0.3], [0.01, 0.002, 0.1])["stiffness"]
    assert told["value"] == pytest.approx(100.0)
    assert told["low"] == pytest.approx(1 / (0.01 + WITHIN * 0.002), rel=1e-4)
    assert told["high"] == pytest.approx(1 / (0.01 - WITHIN * 0.002), rel=1e-4)
    assert quantity(told) == "100 N m/rad"
    bound = _told(ctx, "coulomb_friction:elastic", [0.5, 0.01, 0.3], [0.01, 0.008, 0.1])["stiffness"]
    assert bound["low"] == pytest.approx(1 / (0.01 + WITHIN * 0.008), rel=1e-4) and bound["high"] > 1e9
    assert quantity(bound) == "at least 39 N m/rad"
    stiff = _told(ctx, "coulomb_friction:elastic", [0.5, 1e-9, 0.3], [0.01, 0.002, 0.1])["stiffness"]
    assert stiff["value"] > 1e8 and quantity(stiff) == "at least 260 N m/rad"


def test_intervals_end_where_parameters_do(ctx):
    told = _told(ctx, "quadratic_drag", [0.02], [0.02])["coefficient"]
    assert told["low"] == 0.0 and told["high"] == pytest.approx(0.02 + WITHIN * 0.02, rel=1e-4)
    # of what the model has there may be too much, and no more than that
    given = float(ctx.model.dof_damping[0])
    assert given > 0.0 and _told(ctx, "viscous_damping", [0.02], [1.0])["coefficient"]["low"] == -given


def test_what_follows_from_several_is_linear_in_them(ctx):
    """A wave of amplitude 5 in two parts of 3 and 4, either known to 0.1."""
    told = _told(ctx, "cogging_torque", [3.0, 4.0, 7.0], [0.1, 0.1, 0.01])
    assert told["amplitude"]["value"] == pytest.approx(5.0)
    assert told["amplitude"]["high"] - 5.0 == pytest.approx(WITHIN * 0.1, rel=0.01)
    assert told["periods"]["high"] - 7.0 == pytest.approx(WITHIN * 0.01, rel=0.01)
