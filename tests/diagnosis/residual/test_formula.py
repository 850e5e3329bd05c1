"""Fitted functions in words."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.residual.formula import formula
from tests.diagnosis.machines import PENDULUM
from tests.diagnosis.searches import HINGE

CTX = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
ANGLE, SPEED = Axis("q", -1.2, 1.2), Axis("v", -4.0, 4.0)


def said(axes, law) -> str | None:
    rng = np.random.default_rng(0)
    seen = {a.key: rng.uniform(a.low, a.high, 2000) for a in axes}
    effect = Residual(axes, 4.0)
    values = [seen[a.key] for a in axes]
    theta = np.linalg.lstsq(np.array(effect.basis(np, values)).T, law(*values), rcond=None)[0]
    return formula(effect, theta, seen, Term(effect.id, HINGE), CTX)


@pytest.mark.parametrize(
    ("axes", "law", "words"),
    [
        (
            (ANGLE,),
            lambda q: 0.31 * np.sin(2 * q + 0.4),
            "about 0.31 sin(2q +0.4) N m, for -1.2 < q < 1.2 rad",
        ),
        ((SPEED,), lambda v: -0.05 * v * np.abs(v), "about -0.05 v |v| N m, for -4 < v < 4 rad/s"),
        (
            (ANGLE, SPEED),
            lambda q, v: 0.2 * q * v,
            "about 0.2 q v N m, for -1.2 < q < 1.2 rad and -4 < v < 4 rad/s",
        ),
        ((Axis.within_turn(),), lambda q: 0.2 * np.sin(q - 0.5), "about 0.2 sin(q -0.5) N m"),
        (
            (Axis.within_turn(), SPEED),
            lambda q, v: -0.1 * v * np.cos(q),
            "about 0.1 v sin(q -1.6) N m, for -4 < v < 4 rad/s",
        ),
    ],
)
def test_few_terms_are_told(axes, law, words):
    assert said(axes, law) == words


def test_what_few_terms_do_not_say_is_not_said():
    steps = np.random.default_rng(3).standard_normal(9)
    assert said((ANGLE,), lambda q: np.interp(q, np.linspace(-1.2, 1.2, 9), steps)) is None
    assert said((ANGLE,), lambda q: 0.0 * q) is None
