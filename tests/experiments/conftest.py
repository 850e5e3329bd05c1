"""Trainings that end where they begin."""

import pytest

from experiments.methods import training


@pytest.fixture
def begun(monkeypatch):
    """Trainings end where they begin, in the order in which they were asked for: their first, random steps show where
    an agent acts."""
    states = []

    def stop_at_once(update, state, iterations, **options):
        states.append(state)
        return state, {}

    monkeypatch.setattr(training.loop, "run", stop_at_once)
    return states
