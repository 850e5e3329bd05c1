"""Where one step stands for several, and what is told from such steps."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit
from mpge_jax.diagnosis.estimation.whitening import start_runs
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.cheaper_steps import Near, changes, stride
from mpge_jax.diagnosis.simulation.windows import Windows
from tests.diagnosis.machines import BOX, FINE_ARM, FINE_PENDULUM, record
from tests.diagnosis.searches import DAMPING, fitted, prepared_of, search_of

RUNGE_KUTTA = FINE_PENDULUM.replace("implicitfast", "RK4")
FEW = FINE_PENDULUM.replace('timestep="0.002"', 'timestep="0.01"')
# A period of 0.03 s, which steps of 0.002 s follow and longer ones do not.
STIFF = FINE_PENDULUM.replace('damping="0.02"', 'damping="0.02" stiffness="800"')
SLIDE = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body name="mass"><joint name="x" type="slide"/>
<geom size=".1" mass="1"/></body></worldbody><actuator><motor name="push" joint="x"/></actuator></mujoco>"""
MACHINES = {"smooth": (FINE_PENDULUM, 4), "few steps": (FEW, 1), "stiff": (STIFF, 1), "contacts": (BOX, 1)}


@pytest.mark.parametrize(("xml", "expected"), MACHINES.values(), ids=MACHINES)
def test_steps_are_joined_where_the_motion_stays_the_same(xml, expected):
    p = prepared_of(xml, record(xml, 0.8))
    w = p.windows("train", p.config.decide_s, 20)
    assert stride(p.sim, w) == expected


def test_joined_steps_have_the_mean_command_and_the_same_rows():
    p = prepared_of(FINE_PENDULUM, record(FINE_PENDULUM, 0.8))
    w = p.windows("train", p.config.decide_s, 5)
    joined = w.in_larger_steps(4)
    assert (joined.dt, joined.steps) == (pytest.approx(4 * w.dt), -(-w.steps // 4))
    k = w.steps // 4
    each = w.command[:, w.history : w.history + 4 * k].reshape(5, k, 4, 1).mean(2)
    np.testing.assert_allclose(joined.command[:, joined.history : joined.history + k], each, atol=1e-9)
    np.testing.assert_array_equal(joined.times, w.times)


@pytest.mark.parametrize("xml", [RUNGE_KUTTA, FINE_PENDULUM], ids=["Runge-Kutta", "larger"])
def test_cheaper_steps_tell_differences_and_what_they_promise_is_verified(xml):
    def change(model: mujoco.MjModel) -> None:
        model.dof_damping[0] += 0.03

    s, _ = search_of(xml, record(FINE_PENDULUM, 0.8, change=change))
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
    s, _ = search_of(FINE_PENDULUM, record(FINE_PENDULUM, 0.8))
    run = [Run(fitted(s, {DAMPING: [0.02]}).hypothesis, np.array([0.02]))]
    first = s.sim.cheaply(run, s.train)
    assert s.sim.cheaply(run, s.held).shape[1] == s.held.count
    np.testing.assert_array_equal(s.sim.cheaply(run, s.train), first)
    s.sim.stride = 1
    np.testing.assert_array_equal(s.sim.cheaply(run, s.train), s.sim.residuals(run, s.train))


def test_a_promise_that_is_not_true_is_not_kept(monkeypatch):
    """Cheaper steps of a machine with other damping: what they call the best is not."""
    s, _ = search_of(FINE_PENDULUM, record(FINE_PENDULUM, 0.8))
    start = fitted(s, {DAMPING: [0.01]})
    white = s.whiten_one(start, s.train)
    stepped = s.sim.cheaply

    def wrong(runs: list[Run], w: Windows, exactly: np.ndarray) -> np.ndarray:
        others = [Run(r.hypothesis, 3.0 * np.abs(r.theta - 0.02)) for r in runs]
        return stepped(
            [r if own else other for r, other, own in zip(runs, others, exactly, strict=True)], w, exactly
        )

    monkeypatch.setattr(s.sim, "cheaply", wrong)
    found = fit(s.sim, [start], s.train, white, iterations=3)[0]
    assert found.loss == pytest.approx(evaluate(s.sim, [found], s.train, white)[0].loss, abs=1e-6)
    assert found.loss <= evaluate(s.sim, [start], s.train, white)[0].loss + 1e-9


def test_what_a_start_does_is_told_by_larger_steps_as_by_the_own():
    """A mass without forces: by hand, a start that is off by (q, v) is off by (q + v t, v) at t."""
    s, _ = search_of(SLIDE, record(SLIDE, 0.8))
    assert s.sim.costly(s.train)
    runs = start_runs(Hypothesis(), np.zeros(0), s.train)
    told, root, t = changes(s.sim, runs, s.train), s.train.root[:, 0], s.train.times
    for column in (0, 1):
        q, v = root[:, 0, column, None], root[:, 1, column, None]
        np.testing.assert_allclose(
            told[column, ..., 0], np.where(s.train.seen, -(q + v * t), np.nan), atol=1e-9
        )


def test_smooth_sensitivities_are_alike_in_larger_steps():
    s, _ = search_of(FINE_ARM, record(FINE_ARM, 0.8))
    assert s.sim.stride > 1
    runs = start_runs(Hypothesis(), np.zeros(0), s.train)
    told, own = changes(s.sim, runs, s.train), s.sim.residuals(runs, s.train)
    own = own[1:] - own[0]
    seen = np.isfinite(own)
    for k in range(len(own)):
        assert np.abs((told - own)[k][seen[k]]).max() < 0.05 * np.abs(own[k][seen[k]]).max()


@pytest.fixture(scope="module")
def arm():
    s, _ = search_of(FINE_ARM, record(FINE_ARM, [2.0, 1.0]))
    assert s.sim.stride > 1 and s.sim.costly(s.train)
    one_of_each = {t.id: t for t in s.terms if t.effect.simulated and t.place.index in (0, 1)}
    return s, list(one_of_each.values())


@pytest.mark.parametrize("size", [1.0, 0.2])
def test_cheaper_steps_show_what_any_effect_does(arm, size):
    """Of a guess, and of one nearer to where it vanishes, within half of what it changes and what noise hides."""
    s, terms = arm
    ctx, nothing, nv = s.sim.ctx, Run(Hypothesis(), np.zeros(0)), s.sim.model.nv
    near, share = Near.to(s.sim, nothing, s.train), {}
    for t in terms:
        theta, null = t.effect.starts(ctx, t.place)[0].copy(), t.effect.null(ctx, t.place)
        for k in t.effect.naming(ctx, t.place):
            theta[k] = null[k] + size * (theta[k] - null[k] or t.params(ctx)[k].scale)
        runs = [nothing, Run(Hypothesis.of(t), theta)]
        both = s.sim.residuals(runs, s.train), near.residuals(runs)
        exact, told = (np.nan_to_num(x[1] - x[0])[..., :nv] for x in both)
        hidden = 1e-4 * np.sqrt(exact.size)
        share[t.id] = np.linalg.norm(told - exact) / (np.linalg.norm(exact) + hidden)
    assert "backlash" in share and len(share) > 20
    assert {i: x for i, x in share.items() if not x < 0.5} == {}
