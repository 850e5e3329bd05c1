"""Effects before recordings that they were not fitted to."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.missing_force import missing
from mpge_jax.diagnosis.estimation.prediction_error import Errors
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt
from mpge_jax.diagnosis.selection import confirmation
from mpge_jax.diagnosis.selection.confirmation import confirmed, refitted
from tests.diagnosis.machines import FINE_ARM, record
from tests.diagnosis.searches import ARMATURE, COULOMB, DAMPING, GAIN, fitted, search_of, slight

WINDOWS = 60


@pytest.mark.parametrize("part", ["choice", "test"])
def test_an_effect_that_helps_no_other_recording_goes(rubbing_finely, part):
    """The truth is dry friction of 0.1 N m; nothing is wrong with the gain."""
    s, p = rubbing_finely
    for parts, stay in (
        ({COULOMB: [0.1]}, {COULOMB}),
        ({COULOMB: [0.6]}, set()),
        ({GAIN: [1.5]}, set()),
        ({COULOMB: [0.1], GAIN: [1.3]}, {COULOMB}),
    ):
        f, report, gone = confirmed(p, s, fitted(s, parts), part)
        assert set(f.hypothesis.terms) == stay and set(gone) == set(parts) - stay
        assert (report.after.rms < report.before.rms) == bool(stay)
    assert confirmed(p, s, NOTHING, part)[2] == []


def test_the_others_are_fitted_again(rubbing_finely):
    s, p = rubbing_finely
    f, _, _ = confirmed(p, s, fitted(s, {COULOMB: [0.15], GAIN: [1.3]}), "choice")
    assert f.theta == pytest.approx([0.1], rel=0.1)


def test_an_effect_is_confirmed_though_the_models_steps_miss_more_than_it_explains(monkeypatch):
    """Dry friction of 0.02 N m on an arm with a stiff servo, which moves in half the model's steps."""

    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] = 0.02

    stiff = FINE_ARM.replace('kp="8" kv="0.4"', 'kp="40" kv="1"')
    # four times finer than these
    recordings = record(stiff.replace('"0.002"', '"0.01"'), [4.0, 0.8], change=change, noise=1e-5, count=8)
    s, p = search_of(stiff.replace('"0.002"', '"0.005"'), recordings)
    (rubs,) = (t for t in s.terms if str(t) == "coulomb_friction@shoulder")
    f = refitted(s, fitted(s, {rubs: [0.02]}))
    kept, report, gone = confirmed(p, s, f, "choice")
    assert not gone and kept is f
    # what is reported is what the model's own steps predict
    assert not report.amounts and report.after.rms > 0.01
    monkeypatch.setattr(confirmation, "amounts_seen", lambda _p, _f: {})
    assert confirmed(p, s, f, "choice")[2] == [rubs]


def _errors(*joints: np.ndarray) -> Errors:
    """Errors of windows [W] at each joint."""
    each = np.stack(joints, 1)
    rms = np.sqrt((each**2).mean(1))
    return Errors(float(np.sqrt((each**2).mean())), np.sqrt((each**2).mean(0)), rms, each[:, None])


def _by_hand(monkeypatch, shares: dict, far: float = 50.0) -> None:
    """Confirmation with squared errors of windows that are told: `shares` of each term is what it takes off."""

    def errors_of(hypothesis, further=0.0):
        missed = [x for t, x in shares.items() if t not in hypothesis.terms]
        window = np.sqrt(1000.0 + np.sum([*missed, np.zeros(WINDOWS)], axis=0)) + further
        return _errors(window)

    def report(f):
        before = errors_of(NOTHING.hypothesis, far * (1.0 + np.arange(WINDOWS) / WINDOWS))
        return FitReport(
            None, before, errors_of(f.hypothesis), np.zeros(WINDOWS), 0.0, np.zeros(1), np.ones(1)
        )

    def without(p, f, report):
        fewer = {t: f.hypothesis.without(t) for t in f.hypothesis.terms}
        return {t: errors_of(h, 0.0) if h.terms else report.before for t, h in fewer.items()}

    monkeypatch.setattr(confirmation, "fit_report", lambda p, f, part, *_: report(f))
    monkeypatch.setattr(confirmation, "errors_without", without)
    monkeypatch.setattr(confirmation, "refitted", lambda s, f: f)
    monkeypatch.setattr(confirmation, "_adds", lambda p, f, term, w, here: 0.0)


def test_what_many_explain_a_little_is_not_given_up_one_by_one(rubbing_finely, monkeypatch):
    s, p = rubbing_finely
    terms = (COULOMB, DAMPING, GAIN, ARMATURE)
    _by_hand(monkeypatch, dict(zip(terms, slight(4, WINDOWS), strict=True)))
    f, _, gone = confirmed(p, s, fitted(s, {t: [0.1] for t in terms}), "test")
    assert len(gone) == 1 and len(f.hypothesis.terms) == 3


def test_two_that_help_together_stay_though_neither_is_sure_beside_the_model_as_given(
    rubbing_finely, monkeypatch
):
    s, p = rubbing_finely
    _by_hand(monkeypatch, dict(zip((COULOMB, GAIN), slight(2, WINDOWS), strict=True)), far=0.0)
    f, report, gone = confirmed(p, s, fitted(s, {COULOMB: [0.1], GAIN: [1.1]}), "test")
    assert not gone and len(f.hypothesis.terms) == 2 and report.after.rms < report.before.rms


def test_what_others_do_not_show_goes_and_that_is_said(rubbing_finely, monkeypatch):
    s, p = rubbing_finely
    _by_hand(monkeypatch, {COULOMB: np.full(WINDOWS, 500.0) + np.arange(WINDOWS), GAIN: np.zeros(WINDOWS)})
    f, _, gone = confirmed(p, s, fitted(s, {COULOMB: [0.1], GAIN: [1.1]}), "test")
    assert gone == [GAIN] and f.hypothesis.terms == (COULOMB,)
    assert "actuator gain at motor" in p.warnings[-1] and confirmation.NOT_SHOWN in p.warnings[-1]


@pytest.mark.parametrize(
    ("left", "sure"),
    [
        pytest.param(1.0, True, id="noise alone is left: a drive that saturates now and then"),
        pytest.param(3.0, False, id="more is left: as likely chance"),
    ],
)
def test_a_window_convinces_where_nothing_but_noise_is_left(left, sure):
    floors, after = np.ones(WINDOWS), np.ones(WINDOWS)
    before = after.copy()
    before[0] = 9.0
    after[-1] = before[-1] = left
    evidence = confirmation._evidence(_errors(before), _errors(after), floors)
    assert beyond_doubt(evidence) == sure
    assert (evidence == pytest.approx(40.0)) == sure


@pytest.mark.parametrize(
    ("after", "better"),
    [
        pytest.param([0.001] * 12 + [0.24, 0.11], 1, id="something else acts in two, and all else gains"),
        pytest.param([0.03] * 8 + [0.06] * 4 + [0.3, 0.12], 0, id="about as many lose as gain"),
        pytest.param([0.001] * 8 + [0.4] * 6, -1, id="so many lose so much that most windows do not count"),
    ],
)
def test_windows_in_which_something_else_acts_have_no_more_say_than_others(after, better):
    before, after, floors = np.array([0.043] * 12 + [0.2, 0.1]), np.array(after), np.full(14, 1e-4)
    ratio = confirmation._evidence(_errors(before), _errors(after), floors)
    back = confirmation._evidence(_errors(after), _errors(before), floors)
    assert (beyond_doubt(ratio), beyond_doubt(-ratio)) == (better > 0, better < 0)
    assert back == pytest.approx(-ratio)


def test_what_has_no_name_at_one_joint_does_not_drown_what_is_told_at_another():
    """At the elbow something is missed by a radian, and now more, now less of it with damping at the shoulder."""
    rng, floors = np.random.default_rng(0), np.full(WINDOWS, 1e-4)
    elbow = [1.0 + 0.2 * rng.standard_normal(WINDOWS) for _ in range(2)]
    shoulder = [x * (1.0 + 0.1 * rng.standard_normal(WINDOWS)) for x in (4e-3, 1e-3)]
    without, after = (_errors(a, b) for a, b in zip(elbow, shoulder, strict=True))
    assert beyond_doubt(confirmation._evidence(without, after, floors))
    assert beyond_doubt(-confirmation._evidence(after, without, floors))
    alike = _errors(elbow[1], shoulder[0])
    assert not beyond_doubt(abs(confirmation._evidence(without, alike, floors)))


def test_what_harms_is_no_measure_of_what_is_missed(rubbing_finely, monkeypatch):
    """Without the gain all windows are better; the others' slight shares are then missed from there on."""
    s, p = rubbing_finely
    terms = (COULOMB, DAMPING, ARMATURE)
    _by_hand(
        monkeypatch, {**dict(zip(terms, slight(3, WINDOWS), strict=True)), GAIN: np.full(WINDOWS, -30.0)}
    )
    f, _, gone = confirmed(p, s, fitted(s, {t: [0.1] for t in (*terms, GAIN)}), "test")
    assert gone[0] == GAIN and len(gone) == 2 and len(f.hypothesis.terms) == 2


def test_what_holds_a_machine_where_it_is_adds_to_the_missing_force_and_goes(rubbing_finely, monkeypatch):
    """The truth is dry friction of 0.1 N m; far too much inertia would need forces that nobody gave."""
    s, p = rubbing_finely
    w = p.windows("choice", confirmation.SHORT, WINDOWS, seed=1)
    inertia = 30.0
    heavy = fitted(s, {ARMATURE: [inertia]})
    rubs = fitted(s, {COULOMB: [0.1]})
    assert confirmation._adds(p, heavy, ARMATURE, w, missing(p.sim, heavy, w, p.noise)) > 0.8
    assert confirmation._adds(p, rubs, COULOMB, w, missing(p.sim, rubs, w, p.noise)) < 0.05
    # where force is seldom missing, no effect can add to it
    monkeypatch.setattr(confirmation, "_adds", None)
    assert confirmation._without_what_adds(p, s, rubs, "choice") == (rubs, [])
    monkeypatch.undo()
    f, _, gone = confirmed(p, s, fitted(s, {COULOMB: [0.1], ARMATURE: [inertia]}), "choice")
    assert gone == [ARMATURE] and f.theta == pytest.approx([0.1], rel=0.1)
    assert "armature at " in p.warnings[-1] and confirmation.ADDS in p.warnings[-1]
