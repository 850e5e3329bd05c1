"""What is said of a force that functions model."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.residual.model import Function, ResidualModel

ELBOW, WRIST = Place("joint", "elbow", 1), Place("joint", "wrist", 2)


def of(place: Place, *axes: Axis) -> Function:
    effect = Residual(axes, 3.0)
    return Function(Term(effect.id, place), np.zeros(effect.size), None)


def test_it_depends_on_the_inputs_of_the_functions_that_take_most_of_the_error_away():
    tilt = of(ELBOW, Axis("q", -1.0, 1.0, "wrist"), Axis("v", -3.0, 3.0))
    assert ResidualModel((tilt,), 1.0, 0.7).told("a guess") == (
        "it depends on the position of the wrist and the speed of the joint"
    )
    # 0.71^2 is more than half of the squared error
    assert ResidualModel((tilt,), 1.0, 0.71).told("a guess") == "a guess"
    both = ResidualModel((tilt, of(WRIST, Axis("f", -1.0, 1.0))), 1.0, 0.1)
    assert both.told("a guess") == (
        "at the elbow it depends on the position of the wrist and the speed of the joint; "
        "at the wrist it depends on the force of the joint's drives"
    )
