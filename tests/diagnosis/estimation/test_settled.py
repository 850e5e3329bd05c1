"""Windows that start elsewhere within what the smoother leaves open."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.initial_states import settled
from mpge_jax.diagnosis.estimation.prediction_error import Errors
from mpge_jax.diagnosis.estimation.whitening import numerics, start_runs, whitener
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.recordings.validation import validate
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.windows import Windows
from mpge_jax.diagnosis.thresholds import ELSEWHERE_FROM
from tests.diagnosis.machines import record

BALL = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<geom name="floor" type="plane" size="5 5 1" solref="-4000 -5"/><body name="ball" pos="0 0 .3">
<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<geom name="ball" type="sphere" size=".05" mass=".2" solref="-4000 -5"/></body></worldbody>
<actuator><motor name="lift" joint="z"/></actuator></mujoco>"""
FREE = BALL.replace('type="plane"', 'type="plane" contype="0" conaffinity="0"')


def _windows(xml: str, seconds: float = 3.0, **reality) -> tuple[Prepared, Windows]:
    spec = mujoco.MjSpec.from_string(xml)
    plain = compile_variable(spec)
    recordings = record(xml, 0.5, seconds=seconds, noise=1e-3, **reality)
    p = prepare(spec, [validate(r, plain, names_of(plain)) for r in recordings], Config(jobs=1))
    return p, p.windows("train", p.config.decide_s, 40)


def _excess(p: Prepared, w: Windows) -> np.ndarray:
    h, theta = NOTHING.hypothesis, NOTHING.theta
    white = whitener(p.sim, h, theta, w, p.noise, numerics(p.sim, h, theta, w), temper=False)
    return white.excess(white(p.sim.residuals([Run(NOTHING.hypothesis, NOTHING.theta)], w)))[0]


def _as_predicted(p: Prepared, w: Windows) -> Windows:
    """The same windows with measurements that the model makes from their estimated starts, and noise."""
    residual = p.sim.residuals([Run(NOTHING.hypothesis, NOTHING.theta)], w)[0][..., :2]
    noise = p.noise.qpos * np.random.default_rng(1).standard_normal(residual.shape)
    return replace(w, qpos=w.qpos - residual + noise)


def _aside(w: Windows, by: float) -> Windows:
    """The same windows, every third one estimated `by` deviations off in height and vertical speed."""
    z = np.zeros_like(w.moved)
    z[::3, 1] = by
    shift = replace(w, moved=z).shift
    return replace(w, q0=w.q0 + shift[:, :2], v0=w.v0 + shift[:, 2:])


def test_where_a_window_starts_makes_no_difference_where_motion_is_linear():
    """Moved starts lead back to the estimate by their slopes: whitened residuals are what they were."""
    p, w = _windows(FREE)
    rng = np.random.default_rng(0)
    moved = replace(w, moved=rng.standard_normal(w.moved.shape))
    start = p.sim.residuals([Run(NOTHING.hypothesis, NOTHING.theta)], w)[0]
    there = p.sim.residuals([Run(NOTHING.hypothesis, NOTHING.theta)], moved)[0]
    assert np.nanmax(np.abs(start - there)) > 1e-3
    np.testing.assert_allclose(_excess(p, moved), _excess(p, w), rtol=1e-6)


def test_moved_windows_start_as_a_shifted_run_does():
    p, w = _windows(BALL)
    z = np.zeros_like(w.moved)
    z[:, 1, 0] = 1.0
    moved = p.sim.residuals([Run(NOTHING.hypothesis, NOTHING.theta)], replace(w, moved=z))[0]
    # the third of them: height, first column
    shifted = p.sim.residuals([start_runs(NOTHING.hypothesis, NOTHING.theta, w)[3]], w)[0]
    np.testing.assert_array_equal(moved, shifted)
    index = np.array([2, 0])
    np.testing.assert_array_equal(replace(w, moved=z).take(index).shift, replace(w, moved=z).shift[index])
    assert w.take(np.zeros(0, int)).shift.shape == (0, 4)


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_start_that_explains_a_bounce_is_found(elsewhere):
    p, w = _windows(BALL, seconds=6.0)
    w = _aside(_as_predicted(p, w), 2.0)
    before = _excess(p, w)
    assert (before > ELSEWHERE_FROM).sum() > 2
    after = _excess(p, settled(p.sim, NOTHING, w, p.noise, elsewhere=elsewhere))
    assert (after <= before + 1e-9).all()
    odd = np.flatnonzero(before > ELSEWHERE_FROM)
    assert (after[odd] < 2.0).mean() > 0.8
    np.testing.assert_allclose(np.delete(after, odd), np.delete(before, odd), rtol=1e-9)


def test_a_start_explains_no_force():
    def tailwind(_model, data):
        data.qfrc_applied[0] += 1.0 * np.sin(20.0 * data.time)

    p, w = _windows(BALL, force=tailwind)
    odd = _excess(p, w) > 2.0
    assert odd.any()
    w = w.take(np.concatenate([np.flatnonzero(odd), np.flatnonzero(~odd)]))
    after = _excess(p, settled(p.sim, NOTHING, w, p.noise))
    assert (after[: odd.sum()] > 1.5).mean() > 0.7


def _report(before: list[float], after: list[float], floor: float, moved: float = np.inf) -> FitReport:
    """Errors of windows of which only the sizes matter."""
    b, a = (
        Errors(rms, np.array([rms]), np.array(x), np.zeros(0))
        for x in (before, after)
        for rms in [float(np.sqrt(np.mean(np.square(x))))]
    )
    return FitReport(None, b, a, np.full(len(before), floor), floor, np.full(1, floor), np.array([moved]))


def test_what_is_left_of_the_error_is_that_of_the_usual_window_too():
    """Nine windows go from 10 to 3 over a noise of 1, and impacts spoil a tenth one, before and after."""
    report = _report([10.0] * 9 + [1000.0], [3.0] * 9 + [50.0], 1.0)
    assert report.left(rugged=False) == pytest.approx(0.05, rel=0.1)
    assert report.left(rugged=True) == pytest.approx(np.sqrt(8.0 / 99.0))
    # where the usual window misses nothing, its share means nothing
    report = _report([1.05] * 9 + [1000.0], [1.05] * 9 + [50.0], 1.0)
    assert report.left(rugged=True) == report.left(rugged=False)


def test_what_is_left_of_a_prediction_that_flies_away_is_compared_with_the_motion():
    """Without what is missing a light wrist would turn a hundred times; it moves by 2 rad, of which 1 is missed."""
    assert _report([600.0] * 9, [1.0] * 9, 0.0).left(rugged=False) == pytest.approx(1.0 / 600.0)
    assert _report([600.0] * 9, [1.0] * 9, 0.0, moved=2.0).left(rugged=False) == pytest.approx(0.5)
