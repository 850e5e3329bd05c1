"""How a fit goes: by secants, no further than anything is promised, and checked in the model's own steps."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Param
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import _move, fit, gauss_newton_shift, slopes_of
from mpge_jax.diagnosis.estimation.parameter_steps import Problem, _step
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import COULOMB, DAMPING, fitted, search_of


def test_slopes_follow_what_was_seen_on_the_way():
    """r = A theta in a plane, slopes that are wrong by E: by hand, one move corrects them along its step alone."""
    rng = np.random.default_rng(0)
    true, wrong = rng.standard_normal((2, 2, 3, 4))
    params = [Param("a", "1", -9, 9, 1.0, prior=2.0), Param("b", "1", -9, 9, 1.0, prior=0.5)]
    p = Problem(Fitted(NOTHING.hypothesis, np.zeros(2), np.zeros(2)), params)
    p.whitened, p.jacobian = np.zeros((3, 4)), true + wrong
    for step in ([1.0, 0.0], [0.0, 1.0]):
        theta = p.fit.theta + step
        _move(p, Fitted(NOTHING.hypothesis, theta, theta), np.tensordot(theta, true, 1))
        np.testing.assert_allclose(np.tensordot(step, p.jacobian - true, 1), 0.0, atol=1e-12)
    # two steps that are perpendicular tell both slopes
    np.testing.assert_allclose(p.jacobian, true, atol=1e-12)
    assert p.secant


@pytest.fixture(scope="module")
def rubbing():
    def change(model: mujoco.MjModel) -> None:
        model.dof_damping[0] += 0.03
        model.dof_frictionloss[0] = 0.1

    return search_of(PENDULUM, record(PENDULUM, 0.8, change=change))[0]


def _simulated(monkeypatch, count: list[int]) -> None:
    """Count simulated windows in `count`."""
    chunk = Simulator._chunk

    def counted(sim, runs, w, way):
        count[0] += len(runs) * w.count
        return chunk(sim, runs, w, way)

    monkeypatch.setattr(Simulator, "_chunk", counted)


def test_where_nothing_is_promised_nothing_is_simulated(rubbing, monkeypatch):
    s = rubbing
    white = s.whiten_one(NOTHING, s.train)
    start = fitted(s, {COULOMB: [0.05], DAMPING: [0.0]})
    found = fit(s.sim, [start], s.train, white, tolerance=1e-4)[0]
    assert found.theta == pytest.approx([0.1, 0.03], rel=0.1)
    count = [0]
    _simulated(monkeypatch, count)
    again = fit(s.sim, [found], s.train, white)[0]
    assert count == [0]
    np.testing.assert_array_equal(again.theta, found.theta)
    assert again.loss == pytest.approx(found.loss, abs=1e-9)


def test_secants_lead_where_slopes_do(rubbing, monkeypatch):
    """The same optimum as with slopes that are simulated after each step, by fewer simulations."""
    s = rubbing
    white = s.whiten_one(NOTHING, s.train)
    start = fitted(s, {COULOMB: [0.03], DAMPING: [0.01]})
    ends, counts = [], []
    for anew in (False, True):
        sim, count = Simulator(s.sim.model, s.sim.ctx, stride=s.sim.stride), [0]
        with monkeypatch.context() as m:
            _simulated(m, count)
            if anew:
                m.setattr(
                    "mpge_jax.diagnosis.estimation.levenberg_marquardt.without_slopes",
                    lambda p, _ctx: [p.fit.theta.copy()],
                )
            ends.append(fit(sim, [start], s.train, white)[0])
        counts.append(count[0])
    deviation = np.sqrt(np.diag(ends[1].cov))
    assert (np.abs(ends[0].theta - ends[1].theta) < 0.1 * deviation).all()
    assert counts[0] < 0.7 * counts[1]


def test_a_shift_of_residuals_is_told_in_parameters(rubbing):
    """Residuals as they are at other parameters: those are where it leads, to first order."""
    s = rubbing
    here, there = (fitted(s, {DAMPING: [x]}) for x in (0.02, 0.021))
    assert s.sim.costly(s.train)
    white = s.whiten_one(here, s.train)
    runs = [Run(f.hypothesis, f.theta) for f in (here, there)]
    now, then = white(s.sim.residuals(runs, s.train))
    # predictions that move so are made up for by the opposite change
    shift = gauss_newton_shift(s.sim, here, s.train, white, 2 * now - then)
    assert shift == pytest.approx([0.001], rel=0.05)


@pytest.mark.parametrize("wrong", [1.0, -1.0])
def test_slopes_that_several_fits_share_are_simulated_once(rubbing, monkeypatch, wrong):
    """Damping beside friction, with the slopes of friction told where it stands alone: the same optimum, by fewer
    simulations if those are right, and all the same if they point the other way."""
    s = rubbing
    white = s.whiten_one(NOTHING, s.train)
    alone, both = fitted(s, {COULOMB: [0.11]}), fitted(s, {COULOMB: [0.11], DAMPING: [0.01]})
    ends, counts = [], []
    for shared in (False, True):
        sim, count = Simulator(s.sim.model, s.sim.ctx, stride=s.sim.stride), [0]
        with monkeypatch.context() as m:
            slopes = slopes_of(sim, alone, s.train, white) if shared else None
            if slopes is not None:
                assert set(slopes) == {COULOMB}
                slopes = {COULOMB: wrong * slopes[COULOMB]}
            _simulated(m, count)
            ends.append(fit(sim, [both], s.train, white, slopes=slopes, anew=not shared)[0])
        counts.append(count[0])
    deviation = np.sqrt(np.diag(ends[0].cov))
    assert (np.abs(ends[1].theta - ends[0].theta) < 0.3 * deviation).all()
    assert ends[1].loss == pytest.approx(ends[0].loss, rel=1e-3)
    if wrong == 1.0:
        assert counts[1] < 0.85 * counts[0]
        np.testing.assert_allclose(np.diag(ends[1].cov), np.diag(ends[0].cov), rtol=0.5)
    # in the end slopes are those of the machine if it is asked for
    again = fit(
        s.sim,
        [both],
        s.train,
        white,
        slopes={COULOMB: wrong * slopes_of(s.sim, alone, s.train, white)[COULOMB]},
    )
    np.testing.assert_allclose(again[0].cov, ends[0].cov, rtol=0.1)


def test_of_nothing_there_are_no_slopes(rubbing):
    assert slopes_of(rubbing.sim, NOTHING, rubbing.train, rubbing.whiten_one(NOTHING, rubbing.train)) == {}


def test_a_step_ends_at_bounds_where_it_is_best_with_the_others_there():
    """r = (a + b, a - 3 b - 4), 0 <= a, b <= 5 from (1, 1): free, a = 1 and b = -1; with b = 0, a = 2."""
    params = [Param(name, "1", 0.0, 5.0, 1.0, prior=1e9) for name in "ab"]
    p = Problem(Fitted(NOTHING.hypothesis, np.ones(2), np.ones(2)), params, damping=0.0)
    p.jacobian = np.array([[[1.0, 1.0]], [[1.0, -3.0]]])
    p.whitened = np.array([[2.0, -6.0]])
    p.fit = replace(p.fit, x=np.zeros(1))
    np.testing.assert_allclose(_step(p, p.weight, 0.0), [2.0, 0.0], atol=1e-12)


def test_where_cheaper_steps_lead_astray_the_model_s_own_lead_on(rubbing, monkeypatch):
    """Cheaper steps by which friction does the same everywhere, and damping nothing."""
    s, cheaply = rubbing, Simulator.cheaply

    def wrong(sim, runs, w, exactly=None):
        told = cheaply(sim, runs, w, exactly)
        for r, run in enumerate(runs):
            if exactly is None or not exactly[r]:
                told[r] = 3.0 * run.theta[0]
        return told

    white = s.whiten_one(NOTHING, s.train)
    monkeypatch.setattr(Simulator, "cheaply", wrong)
    assert s.sim.costly(s.train)
    found = fit(s.sim, [fitted(s, {COULOMB: [0.05], DAMPING: [0.0]})], s.train, white, iterations=12)[0]
    assert found.theta == pytest.approx([0.1, 0.03], rel=0.1)
