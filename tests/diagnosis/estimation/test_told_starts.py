"""Starts that a model tells from the first rows of a window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.prediction_error import MeanSquare, errors, noise_floor, numerical_floor
from mpge_jax.diagnosis.estimation.told_starts import left_open, told
from mpge_jax.diagnosis.estimation.whitening import STEP
from tests.diagnosis.machines import FINE_ARM, record
from tests.diagnosis.searches import COULOMB, prepared_of

TRUTH = Fitted(Hypothesis.of(COULOMB), np.array([0.1]), np.array([0.1]))


@pytest.fixture(scope="module")
def windows(rubbing):
    """The machine with its windows, and the same from velocities that are wrong by three of their deviations."""
    _, p = rubbing
    w = p.windows("test", 0.5, 6)
    off = np.zeros_like(w.moved)
    off[:, 0, 1] = 3.0
    return p, w, replace(w, v0=w.v0 + replace(w, moved=off).shift[:, 1:])


def test_a_wrong_velocity_is_mended_by_the_true_model(windows):
    p, w, wrong = windows
    right, again = (told(p.sim, TRUTH, x, p.noise) for x in (w, wrong))
    deviation = np.abs(replace(w, moved=np.ones_like(w.moved)).shift[:, 1])
    off, left = (
        np.abs(a - b)[:, 0]
        for a, b in ((wrong.v0, w.v0), (again.v0 + again.shift[:, 1:], right.v0 + right.shift[:, 1:]))
    )
    assert (left < 0.2 * off).all() and (off > deviation).all()
    assert errors(p.sim, TRUTH, wrong, p.noise).rms < 1.1 * errors(p.sim, TRUTH, w, p.noise).rms
    assert errors(p.sim, TRUTH, w, p.noise).rms < 0.5 * errors(p.sim, NOTHING, w, p.noise).rms


def test_every_window_is_told_by_itself_and_to_the_end(windows):
    """Windows that need fewer steps than others stop earlier."""
    p, w, wrong = windows
    both = w.take(np.tile(np.arange(w.count), 2))
    both = replace(both, v0=np.concatenate([w.v0, wrong.v0]))
    whole = told(p.sim, TRUTH, both, p.noise)
    each = [told(p.sim, TRUTH, both.take([k]), p.noise).moved[0] for k in range(both.count)]
    np.testing.assert_allclose(whole.moved, each, atol=1e-9)
    # further steps move none by more than a hundredth of a deviation
    again = told(p.sim, TRUTH, whole, p.noise)
    np.testing.assert_allclose(again.moved, whole.moved, atol=0.01)


def test_what_is_compared_tells_no_start(windows):
    p, w, _ = windows
    hidden = replace(w, qpos=np.where(w.seen[..., None], 0.3, w.qpos))
    np.testing.assert_array_equal(
        told(p.sim, TRUTH, hidden, p.noise).moved, told(p.sim, TRUTH, w, p.noise).moved
    )
    hidden = replace(w, qpos=np.where(w.lead[..., None], 0.3, w.qpos))
    assert (
        (told(p.sim, TRUTH, hidden, p.noise).moved != told(p.sim, TRUTH, w, p.noise).moved).any((1, 2)).all()
    )


def test_less_is_left_open_than_before_and_errors_are_as_large_as_that(null):
    _, p = null
    w = p.windows("test", 0.5, 6)
    cov = left_open(p.sim, NOTHING, w, p.noise)
    assert (np.linalg.eigvalsh(np.eye(2) - cov) > -1e-9).all() and (np.linalg.det(cov) < 0.5).all()
    # the recording was made in steps a quarter as long: one and a half times what halving them changes
    steps = numerical_floor(p.sim, NOTHING, w, p.noise, {STEP: 1.5})
    floor = np.sqrt((noise_floor(p.sim, NOTHING, w, p.noise, np.zeros(p.model.nu)) + steps).window.mean())
    assert 0.7 * floor < errors(p.sim, NOTHING, w, p.noise).rms < 1.5 * floor


def test_predictions_with_the_steps_of_the_recordings_are_as_good_as_noise_lets_them_be():
    """A stiff servo, recorded in half the model's steps."""
    stiff = FINE_ARM.replace('kp="8" kv="0.4"', 'kp="40" kv="1"')
    recordings = record(stiff.replace('"0.002"', '"0.01"'), [0.4, 0.8], noise=1e-5)
    p = prepared_of(stiff.replace('"0.002"', '"0.005"'), recordings)
    w = p.windows("test", 0.5, 6)
    plain, none, half = (errors(p.sim, NOTHING, w, p.noise, x) for x in ({}, {STEP: 0.0}, {STEP: 1.0}))
    assert none.rms == plain.rms and half.rms < 0.2 * plain.rms
    steps = numerical_floor(p.sim, NOTHING, w, p.noise, {STEP: 1.0})
    assert np.sqrt(steps.window.mean()) == pytest.approx(plain.rms, rel=0.2)


def test_mean_squares_by_hand():
    """Two windows of two rows, of two joints of which the second is seen once."""
    square = np.array([[[1.0, 5.0], [3.0, 9.0]], [[2.0, 7.0], [4.0, 7.0]]])
    seen = np.array([[[True, True], [True, False]], [[True, False], [True, False]]])
    once = MeanSquare.of(square, seen)
    np.testing.assert_allclose(once.window, [3.0, 3.0])
    np.testing.assert_allclose(once.joint, [2.5, 5.0])
    np.testing.assert_allclose((once + once).joint, [5.0, 10.0])


def test_windows_that_keep_no_rows_for_it_stay_as_they_are(rubbing):
    _, p = rubbing
    w = p.windows("train", 0.25, 4)
    assert told(p.sim, TRUTH, w, p.noise) is w
    np.testing.assert_array_equal(left_open(p.sim, TRUTH, w, p.noise)[0], np.eye(2))


def test_slopes_of_a_fit_nearby_serve_where_the_machine_is_smooth(windows):
    p, _, wrong = windows
    own = told(p.sim, TRUTH, wrong, p.noise)
    near = told(p.sim, TRUTH, wrong, p.noise, near=NOTHING)
    assert (near.moved != own.moved).any()
    np.testing.assert_allclose(near.moved, own.moved, atol=0.02)
    # inside a gap parts strike each other: slopes of one fit say nothing of another
    gap = np.array([0.02, 0.5])
    rattles = Fitted(Hypothesis.of(Term("backlash", COULOMB.place)), gap, gap)
    np.testing.assert_array_equal(told(p.sim, TRUTH, wrong, p.noise, near=rattles).moved, own.moved)
    its = told(p.sim, rattles, wrong, p.noise)
    np.testing.assert_array_equal(told(p.sim, rattles, wrong, p.noise, near=TRUTH).moved, its.moved)
