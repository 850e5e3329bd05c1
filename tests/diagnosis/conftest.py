"""Machines that several rooms' tests look at."""

from __future__ import annotations

import mujoco
import pytest

from mpge_jax.diagnosis.residual import motion
from mpge_jax.diagnosis.residual.inputs import functions
from mpge_jax.diagnosis.verdict import judgement
from tests.diagnosis.machines import FINE_PENDULUM, PENDULUM, really_sticks, record
from tests.diagnosis.searches import look_for_nothing_beside, search_of


@pytest.fixture(scope="module")
def null():
    return search_of(FINE_PENDULUM, record(FINE_PENDULUM, 0.8))


def _rubs(xml: str):
    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] = 0.1
        really_sticks(model, 0)

    return search_of(xml, record(xml, 0.8, change=change))


@pytest.fixture(scope="module")
def rubbing():
    return _rubs(PENDULUM)


@pytest.fixture(scope="module")
def rubbing_finely():
    """Where friction within a step matters."""
    return _rubs(FINE_PENDULUM)


@pytest.fixture
def left_alone(monkeypatch):
    """What is left is told and no more: nothing is looked for beside it, and no function models it."""
    look_for_nothing_beside(monkeypatch)
    monkeypatch.setattr(judgement, "residual_of_motion", lambda *_: None)


@pytest.fixture(scope="module")
def plain_functions():
    """What is left is modelled by functions of one input alone: looking through the hundreds of others takes nearly all
    the time of a diagnosis that leaves something, and is asked of tests of those functions."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            motion,
            "functions",
            lambda values, hinge: [
                e
                for e in functions(values, hinge)
                if len(e.axes) == 1 and e.axes[0].parts == 1 and not (e.coupled or e.dry or e.traced)
            ],
        )
        yield
