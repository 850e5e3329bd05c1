"""Machines that several rooms' tests look at."""

from __future__ import annotations

import mujoco
import pytest

from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import search_of


@pytest.fixture(scope="module")
def null():
    return search_of(PENDULUM, record(PENDULUM, 0.8))


@pytest.fixture(scope="module")
def rubbing():
    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] = 0.1
        model.dof_solref[0], model.dof_solimp[0] = [-1, -1800], [0.98, 0.99, 0.001, 0.5, 2]

    return search_of(PENDULUM, record(PENDULUM, 0.8, change=change))
