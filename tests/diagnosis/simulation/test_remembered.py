"""What is not simulated twice."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.pushes import Push
from mpge_jax.diagnosis.simulation.remembered import Remembered
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import DAMPING, prepared_of


def rows(*values: float) -> np.ndarray:
    return np.array(values)[:, None]


def test_what_is_known_is_recalled_and_what_is_asked_for_twice_is_new_once():
    known, out = Remembered(), rows(0, 0, 0)
    assert known.recall("aba", out) == [0, 1]
    out[:2] = rows(5, 7)
    known.keep("aba", out, [0, 1], None)
    assert out[2] == 5
    out[0] = 9  # what was kept is a copy
    again = rows(0, 0)
    assert known.recall("cb", again) == [0] and again[1] == 7
    assert known.recall("a", again) == [] and again[0] == 5


def test_what_was_not_asked_for_longest_goes_first():
    known, each = Remembered(room=2 * 8), rows(1)
    for key in "ab":
        known.keep(key, each, known.recall(key, each), None)
    known.recall("a", each)
    known.keep("c", each, known.recall("c", each), None)
    assert [known.recall(key, each) for key in "abc"] == [[], [0], []]


@pytest.fixture(scope="module")
def swinging():
    p = prepared_of(PENDULUM, record(PENDULUM, 0.8))
    return p.sim, p.windows("train", p.config.decide_s, 6)


def test_the_same_runs_of_the_same_windows_are_simulated_once(swinging, monkeypatch):
    sim, w = swinging
    asked: list[int] = []
    chunk = Simulator._chunk
    monkeypatch.setattr(
        Simulator, "_chunk", lambda s, runs, *at: asked.append(len(runs)) or chunk(s, runs, *at)
    )
    runs = [Run(Hypothesis.of(DAMPING), np.array([x])) for x in (0.01, 0.02)]
    before = sim.work
    first, spent = sim.residuals(runs, w), sim.work - before
    again = sim.residuals([runs[1], Run(runs[0].hypothesis, np.array([0.03])), runs[0]], w.take(np.arange(6)))
    assert asked == [2, 1]
    np.testing.assert_array_equal(again[[0, 2]], first[[1, 0]])
    # what is decided by the work done does not hang on what is remembered
    assert sim.work - before - spent == pytest.approx(1.5 * spent)
    alone = Simulator(sim.model, sim.ctx).residuals(runs, w)
    np.testing.assert_array_equal(alone, first)


def test_whatever_changes_a_simulation_is_told_apart(swinging, monkeypatch):
    sim, w = swinging
    run = Run(Hypothesis.of(DAMPING), np.array([0.05]))
    asked: list[int] = []
    sim.residuals([run], w)
    chunk = Simulator._chunk
    monkeypatch.setattr(Simulator, "_chunk", lambda s, *given: asked.append(1) or chunk(s, *given))
    moved = w.moved.copy()
    moved[0, 0, 0] = 0.1
    others = [w.later(w.dt / 2), w.refined(2), w.take(np.arange(5)), replace(w, moved=moved)]
    for k, x in enumerate(others):
        sim.residuals([run], x)
        assert len(asked) == k + 1
    for k, r in enumerate([replace(run, theta=np.array([0.06])), replace(run, push=Push(0, 0.1))]):
        sim.residuals([r], w)
        assert len(asked) == len(others) + k + 1
    with sim.integrator(mujoco.mjtIntegrator.mjINT_RK4):
        sim.residuals([run], w)
    assert len(asked) == len(others) + 3
    sim.residuals([run], w)
    assert len(asked) == len(others) + 3
