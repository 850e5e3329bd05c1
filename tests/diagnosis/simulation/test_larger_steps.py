"""Where one step stands for several, and what is told from such steps."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.larger_steps import stride
from mpge_jax.diagnosis.simulation.near import Near
from mpge_jax.diagnosis.simulation.windows import Windows
from tests.diagnosis.machines import BOX, PENDULUM, record
from tests.diagnosis.searches import DAMPING, fitted, prepared_of, search_of

RUNGE_KUTTA = PENDULUM.replace("implicitfast", "RK4")
FEW = PENDULUM.replace('timestep="0.002"', 'timestep="0.01"')
# A period of 0.03 s, which steps of 0.002 s follow and longer ones do not.
STIFF = PENDULUM.replace('damping="0.02"', 'damping="0.02" stiffness="800"')
MACHINES = {"smooth": (PENDULUM, 4), "few steps": (FEW, 1), "stiff": (STIFF, 1), "contacts": (BOX, 1)}


@pytest.mark.parametrize(("xml", "expected"), MACHINES.values(), ids=MACHINES)
def test_steps_are_joined_where_the_motion_stays_the_same(xml, expected):
    p = prepared_of(xml, record(xml, 0.8))
    w = p.windows("train", p.config.decide_s, 20)
    assert stride(p.sim, w) == expected


def test_joined_steps_have_the_mean_command_and_the_same_rows():
    p = prepared_of(PENDULUM, record(PENDULUM, 0.8))
    w = p.windows("train", p.config.decide_s, 5)
    joined = w.in_larger_steps(4)
    assert (joined.dt, joined.steps) == (pytest.approx(4 * w.dt), -(-w.steps // 4))
    k = w.steps // 4
    each = w.command[:, w.history : w.history + 4 * k].reshape(5, k, 4, 1).mean(2)
    np.testing.assert_allclose(joined.command[:, joined.history : joined.history + k], each, atol=1e-9)
    np.testing.assert_array_equal(joined.times, w.times)


@pytest.mark.parametrize("xml", [RUNGE_KUTTA, PENDULUM], ids=["Runge-Kutta", "larger"])
def test_cheaper_steps_tell_differences_and_what_they_promise_is_verified(xml):
    def change(model: mujoco.MjModel) -> None:
        model.dof_damping[0] += 0.03

    s, _ = search_of(xml, record(PENDULUM, 0.8, change=change))
    assert s.sim.stride > 1 and s.sim.costly(s.train)
    known, other = fitted(s, {DAMPING: [0.02]}), fitted(s, {DAMPING: [0.03]})
    runs = [Run(f.hypothesis, f.theta) for f in (known, other)]
    near, exact = Near.to(s.sim, runs[0], s.train).residuals(runs), s.sim.residuals(runs, s.train)
    seen = np.isfinite(exact[0])
    np.testing.assert_allclose(near[0][seen], exact[0][seen], atol=1e-12)
    # the difference between two runs is told far better than a run
    alone = s.sim.cheaply(runs, s.train)
    wrong = [np.abs(x[1] - exact[1])[seen].max() for x in (near, alone)]
    assert wrong[0] < 0.2 * wrong[1]
    white = s.whiten_one(known, s.train)
    found = fit(s.sim, [known], s.train, white)[0]
    assert found.theta[0] == pytest.approx(0.03, rel=0.02)
    assert found.loss == pytest.approx(evaluate(s.sim, [found], s.train, white)[0].loss, abs=1e-4)
    # where it ends is where the model's own steps lead, far within what the data leave open
    s.sim.stride = 1
    own = fit(s.sim, [known], s.train, white)[0]
    assert abs(found.theta[0] - own.theta[0]) < 0.1 * np.sqrt(own.cov[0, 0])


def test_other_windows_are_stepped_anew():
    s, _ = search_of(PENDULUM, record(PENDULUM, 0.8))
    run = [Run(fitted(s, {DAMPING: [0.02]}).hypothesis, np.array([0.02]))]
    first = s.sim.cheaply(run, s.train)
    assert s.sim.cheaply(run, s.held).shape[1] == s.held.count
    np.testing.assert_array_equal(s.sim.cheaply(run, s.train), first)
    s.sim.stride = 1
    np.testing.assert_array_equal(s.sim.cheaply(run, s.train), s.sim.residuals(run, s.train))


def test_a_promise_that_is_not_true_is_not_kept(monkeypatch):
    """Cheaper steps of a machine with other damping: what they call the best is not."""
    s, _ = search_of(PENDULUM, record(PENDULUM, 0.8))
    start = fitted(s, {DAMPING: [0.01]})
    white = s.whiten_one(start, s.train)
    stepped = s.sim.cheaply

    def wrong(runs: list[Run], w: Windows) -> np.ndarray:
        return stepped([Run(r.hypothesis, 3.0 * np.abs(r.theta - 0.02)) for r in runs], w)

    monkeypatch.setattr(s.sim, "cheaply", wrong)
    found = fit(s.sim, [start], s.train, white, iterations=3)[0]
    assert found.loss == pytest.approx(evaluate(s.sim, [found], s.train, white)[0].loss, abs=1e-6)
    assert found.loss <= evaluate(s.sim, [start], s.train, white)[0].loss


def test_what_was_simulated_near_the_model_as_given_is_not_simulated_again(monkeypatch):
    s, _ = search_of(PENDULUM, record(PENDULUM, 0.8))
    nothing, some = Run(Hypothesis(), np.zeros(0)), s.train.take(np.arange(5))
    runs = [Run(Hypothesis.of(DAMPING), np.array([x])) for x in (0.01, 0.02, 0.03)]
    before = s.sim.work
    first = Near.to(s.sim, nothing, some).residuals(runs)
    spent = s.sim.work - before
    asked = []
    stepped = s.sim.cheaply
    monkeypatch.setattr(s.sim, "cheaply", lambda r, w: asked.append(len(r)) or stepped(r, w))
    more = [runs[1], Run(runs[0].hypothesis, np.array([0.04])), runs[0]]
    before = s.sim.work
    again = Near.to(s.sim, nothing, s.train.take(np.arange(5))).residuals(more)
    # the known run, and what is new
    assert asked == [1, 1]
    np.testing.assert_array_equal(again[[0, 2]], first[[1, 0]])
    assert s.sim.work - before == pytest.approx(spent)
    plain = Simulator(s.sim.model, s.sim.ctx, stride=s.sim.stride)
    np.testing.assert_array_equal(Near.to(plain, nothing, some).residuals(more), again)
    # other windows, or another known run: simulated
    for known, w in ((nothing, s.train.take(np.arange(1, 6))), (runs[2], some)):
        asked.clear()
        Near.to(s.sim, known, w).residuals(runs)
        assert asked == [1, 3]
