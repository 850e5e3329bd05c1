"""Steps of fits, their intervals, and the windows' whitening."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Param
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation import levenberg_marquardt
from mpge_jax.diagnosis.estimation.covariance import finish, jackknife, recordings_differ, widened
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import _better, _tried, fit, timing_error
from mpge_jax.diagnosis.estimation.parameter_steps import Problem, beyond, too_slow
from mpge_jax.diagnosis.selection.backward_elimination import final_fit, refined
from tests.diagnosis.machines import BOX, FINE_PENDULUM, PENDULUM, really_sticks, record
from tests.diagnosis.searches import COULOMB, DAMPING, HINGE, fitted, search_of


def test_training_and_held_out_windows_are_tempered_alike():
    s, _ = search_of(PENDULUM, record(PENDULUM, 0.8, lambda m: m.dof_frictionloss.__setitem__(0, 0.1)))
    train, held = s.whiten(NOTHING)
    assert train.factor > 1.5 and held.factor == train.factor
    assert all(white.factor == 1.0 for white in s.whiten(NOTHING, temper=False))


@pytest.fixture(scope="module")
def sliding():
    return search_of(BOX, record(BOX, 6.0))


def test_drag_of_a_body_is_sized_by_how_fast_that_body_moves(sliding):
    s, p = sliding
    speeds = np.concatenate([np.linalg.norm(x.states.qvel, axis=1) for x in p.train])
    assert p.ctx.body_speed[1] == pytest.approx(np.sqrt((speeds**2).mean()), rel=0.15)
    term = next(t for t in s.terms if t.id == "quadratic_drag" and t.place.kind == "body")
    assert term.params(p.ctx)[0].scale == pytest.approx(0.1 * p.ctx.weight / p.ctx.body_speed[1] ** 2)


def test_steps_are_stretched_where_there_are_contacts_alone(sliding, rubbing_finely):
    (s, _), (smooth, _) = sliding, rubbing_finely
    term = next(t for t in s.terms if t.id == "viscous_damping")
    start = fitted(s, {term: [1.0]})
    problem = Problem(start, term.params(s.sim.ctx))
    high = problem.params[0].high
    found = beyond(problem, np.array([1.5]), s.sim.ctx)
    np.testing.assert_allclose(np.ravel(found), np.minimum([2.5, 5.0], high))
    assert beyond(problem, np.array([0.5]), s.sim.ctx)[1] == 0.0
    assert beyond(problem, np.array([1.5]), smooth.sim.ctx) == []


def test_a_step_that_goes_nowhere_is_no_gain(rubbing_finely):
    """By cheaper steps a loss may be another one at the same parameters; a direction of no length has no slope."""
    s, _ = rubbing_finely
    f = replace(fitted(s, {DAMPING: [0.02]}), loss=np.inf)
    problem, white = Problem(f, f.hypothesis.params(s.sim.ctx)), s.whiten_one(f, s.train)
    assert not _tried(s.sim, [(problem, f.theta.copy())], s.train, white)
    trials = [(problem, f.theta.copy()), (problem, f.theta + 0.01)]
    ((better, _),) = _better(_tried(s.sim, trials, s.train, white)).values()
    assert better.theta == f.theta + 0.01


def test_terms_that_are_to_stay_do(rubbing_finely):
    s, _ = rubbing_finely
    start = fitted(s, {DAMPING: [0.03], COULOMB: [0.01]})
    part = dict(zip(start.hypothesis.terms, start.hypothesis.slices(s.sim.ctx), strict=True))
    white = s.whiten_one(start, s.train)
    held, free = (fit(s.sim, [start], s.train, white, iterations=12, still=x)[0] for x in ([DAMPING], []))
    np.testing.assert_array_equal(held.theta[part[DAMPING]], [0.03])
    assert free.theta[part[DAMPING]] < 0.02 and free.theta[part[COULOMB]] > 2 * held.theta[part[COULOMB]]
    assert free.loss < held.loss < fit(s.sim, [start], s.train, white, iterations=0)[0].loss


def test_a_fit_is_given_up_where_it_would_not_get_there_at_its_pace(rubbing_finely):
    losses = [9.0, 6.0, 4.5, 3.7]
    # the better of the last two steps gained 1.5: 3.7 - 2 * 1.5 = 0.7
    assert too_slow(losses, 2, 0.6) and not too_slow(losses, 2, 0.8)
    assert not too_slow(losses[:3], 0, 0.6), "two steps tell no pace"
    assert not too_slow([9.0, 6.0, 4.5, 4.5], 3, 0.1), "a step that was refused says nothing"
    assert not too_slow(losses, 2, np.inf)

    s, _ = rubbing_finely
    start, white = fitted(s, {DAMPING: [0.0]}), s.whiten_one(NOTHING, s.train)
    (whole,) = fit(s.sim, [start], s.train, white)
    before = s.sim.work
    (to_end,) = fit(s.sim, [start], s.train, white, goal=1.01 * whole.loss)
    enough = s.sim.work - before
    assert to_end.theta == pytest.approx(whole.theta)
    (given_up,) = fit(s.sim, [start], s.train, white, goal=0.0)
    assert s.sim.work - before - enough < enough and whole.loss <= given_up.loss


def test_detours_are_taken_at_first_and_then_where_slopes_lead_nowhere(rubbing_finely, monkeypatch):
    s, _ = rubbing_finely
    aside, seen = 0.7, []

    def tried(sim, trials, w, white):
        found = _tried(sim, trials, w, white)
        detours = [bool(np.allclose(t - p.fit.theta, aside)) for p, t in trials]
        seen.append((any(detours), any(f.loss < p.fit.loss for p, f, _ in found)))
        return found

    monkeypatch.setattr(levenberg_marquardt, "without_slopes", lambda p, ctx: [p.fit.theta + aside])
    monkeypatch.setattr(levenberg_marquardt, "_tried", tried)
    start = fitted(s, {DAMPING: [0.0]})
    fit(s.sim, [start], s.train, s.whiten_one(start, s.train))
    # of each iteration, what is tried at once and what only where that is no better
    (at_once, _), *later = zip(seen[::2], seen[1::2], strict=True)
    assert at_once == (True, True)
    assert {(better, detour) for (_, better), (detour, _) in later} == {(True, False), (False, True)}
    assert not any(detour for (detour, _), _ in later)


def test_times_are_known_to_a_part_of_a_timestep():
    params = [Param("delay", "s", 0, 1, 0.01), Param("gain", "1", 0, 2, 0.1)]
    np.testing.assert_allclose(timing_error(params, np.array([0.01, 1.0]), 0.002), [0.002 / 12**0.5, 0.0])
    np.testing.assert_allclose(timing_error(params, np.array([0.01, 1.0]), 0.02), [0.001, 0.0])


def test_the_number_of_cogs_is_found_from_a_wrong_one():
    periods, amplitude = 30.0, 0.08

    def cogs(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[0] = amplitude * np.sin(periods * data.qpos[0])

    s, p = search_of(FINE_PENDULUM, record(FINE_PENDULUM, 0.5, force=cogs, seconds=3.0))
    term = Term("cogging_torque", HINGE)
    travel = float(np.ptp(p.ctx.samples.q[:, 0]))
    middle = float(np.median(p.ctx.samples.q[:, 0]))
    theta = np.array([-0.02, 0.05, periods - 9.0 / travel])
    for a, b, n in term.effect.detours(p.ctx, HINGE, theta):
        torques = [x * np.sin(k * middle) + y * np.cos(k * middle) for x, y, k in (theta, (a, b, n))]
        assert torques[0] == pytest.approx(torques[1])
    start = Fitted(Hypothesis.of(term), theta, theta)
    f = fit(s.sim, [start], s.train, s.whiten_one(start, s.train), iterations=12)[0]
    assert f.theta[2] == pytest.approx(periods, rel=0.01)
    assert np.hypot(*f.theta[:2]) == pytest.approx(amplitude, rel=0.05)


def test_variances_are_those_of_leaving_out_each_window():
    """Linear regression, with one window of much weight that is far off: exact."""
    rng = np.random.default_rng(0)
    windows, samples = 12, 5
    x = rng.standard_normal((windows, samples, 2))
    x[0] *= 5
    y = x @ [1.0, -2.0] + rng.standard_normal((windows, samples)) * np.r_[6.0, np.ones(windows - 1)][:, None]

    def regression(index: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(x[index].reshape(-1, 2), y[index].ravel(), rcond=None)[0]

    everything = np.arange(windows)
    theta = regression(everything)
    moved = np.array([regression(np.delete(everything, k)) for k in everything])
    parts = np.einsum("wmp,wmq->wpq", x, x)
    precision = parts.sum(0)
    fewer = [np.linalg.inv(precision - each) for each in parts]
    by_noise = sum(np.diag(each - np.linalg.inv(precision)) for each in fewer) * (windows - 1) / windows
    # also where the fit stopped before it arrived
    for reached in (theta, theta + np.array([0.5, -0.3])):
        scores = np.einsum("wmp,wm->wp", x, y - x @ reached)
        variances = jackknife(precision, parts, scores, 1 / np.sqrt(np.diag(precision)))
        np.testing.assert_allclose(variances[0], ((moved - theta) ** 2).sum(0) * (windows - 1) / windows)
        np.testing.assert_allclose(variances[1], by_noise)


@pytest.mark.parametrize(
    ("differ", "alone", "with_it"), [(0.0, (0.92, 0.98), (0.94, 1.0)), (0.3, (0.5, 0.75), (0.85, 0.98))]
)
def test_intervals_hold_what_recordings_say_otherwise(differ, alone, with_it):
    """A coefficient that is another one in each of four recordings, as of a law that is not quite the machine's."""
    rng, held = np.random.default_rng(3), np.zeros((400, 2))
    source, param = np.repeat(np.arange(4), 10), Param("k", "1", -10.0, 10.0, 1.0)
    for k in range(400):
        x = rng.standard_normal((40, 5))
        true = 1.0 + differ * rng.standard_normal(4)
        y = x * true[source][:, None] + rng.standard_normal((40, 5))
        theta = float((x * y).sum() / (x**2).sum())
        left = x * theta - y
        found = replace(NOTHING, theta=np.array([theta]), x=(left**2).mean(1))
        p = Problem(found, [param], jacobian=x[None], whitened=left)
        cov = finish(p).cov
        wide = widened(cov, np.sqrt(recordings_differ(p, source)))
        held[k] = [abs(theta - 1.0) < 1.96 * np.sqrt(c[0, 0]) for c in (cov, wide)]
    assert alone[0] < held[:, 0].mean() < alone[1]
    assert with_it[0] < held[:, 1].mean() <= with_it[1]
    assert not recordings_differ(p, np.zeros(40)).any()


def test_intervals_hold_the_truth_as_often_as_they_say():
    """24 intervals of 95 %: that fewer than 20 hold is less likely than 1 in 100."""
    true, held = {COULOMB: 0.1, DAMPING: 0.03}, 0

    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0], model.dof_damping[0] = true[COULOMB], model.dof_damping[0] + true[DAMPING]
        really_sticks(model, 0)

    for seed in range(12):
        s, p = search_of(PENDULUM, record(PENDULUM, 0.8, change=change, noise=1e-3, seed=seed))
        near, _ = final_fit(s, fitted(s, {t: [v] for t, v in true.items()}))
        f = refined(s, near, p.windows("train", p.config.report_s, 60))
        for t, part in zip(f.hypothesis.terms, f.hypothesis.slices(s.sim.ctx), strict=True):
            half = 1.96 * np.sqrt(f.cov[part, part][0, 0])
            held += abs(f.theta[part][0] - true[t]) < half
            assert half < 0.3 * true[t]
    assert held >= 20
