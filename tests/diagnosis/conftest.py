"""Machines that several rooms' tests look at."""

from __future__ import annotations

import mujoco
import pytest

from mpge_jax.diagnosis.residual import motion
from tests.diagnosis.machines import PENDULUM, really_sticks, record
from tests.diagnosis.searches import search_of


@pytest.fixture(scope="module")
def null():
    return search_of(PENDULUM, record(PENDULUM, 0.8))


@pytest.fixture(scope="module")
def rubbing():
    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] = 0.1
        really_sticks(model, 0)

    return search_of(PENDULUM, record(PENDULUM, 0.8, change=change))


@pytest.fixture
def few_windows(monkeypatch):
    """Functions of what is left are fitted to a third of the windows: they take as long as these are many."""
    monkeypatch.setattr(motion, "WINDOWS", 30)
