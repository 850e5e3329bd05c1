"""Where one unknown force explains far more than all that was named, effects are searched for beside it."""

from __future__ import annotations

from itertools import chain, repeat
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.prediction_error import errors
from mpge_jax.diagnosis.evidence.held_out_error import error_drops, fit_report, judged
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.residual.model import Function, with_function
from mpge_jax.diagnosis.selection.procedure import Decision, what_is_left
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.verdict import beside_unknown as module
from mpge_jax.diagnosis.verdict.beside_unknown import _far_better, beside_unknown
from tests.diagnosis.machines import ARM, record
from tests.diagnosis.searches import COULOMB, DAMPING, GAIN, HINGE, fitted

SPEED = Residual((Axis("v", -4.0, 4.0),), 4.0)
RUBS = Function(Term(SPEED.id, HINGE), -0.1 * np.tanh(9.0 * np.linspace(-1, 1, 9)), None)


@pytest.fixture
def asked(rubbing, monkeypatch):
    """What is left beside a gain of a pendulum that rubs, and what `beside_unknown` makes of it.

    Called with whether there is a function, by how much it is better than what was named alone and with functions, and
    what is found beside it.
    """
    s, p = rubbing
    gain = fitted(s, {GAIN: [0.9]})
    noise, left = what_is_left(p, gain, s)
    assert left is not None
    searched, told = [], []

    def decide_roughly(machine, search, _looked):
        searched.append((machine, search))
        return Decision(searched_for, {}, Floor(), None, search)

    def ask(functions, better, found, fit=gain, looked=()):
        nonlocal searched_for
        searched_for = found
        answers = iter(better)
        monkeypatch.setattr(module, "functions_of_motion", lambda *args: beside(functions, *args))
        monkeypatch.setattr(module, "predicts_better", lambda *_: bool(better))
        monkeypatch.setattr(module, "_far_better", lambda *_: next(answers, False))
        monkeypatch.setattr(module, "decide_roughly", decide_roughly)
        monkeypatch.setattr(module, "tested", lambda _p, _s, decision: (decision, None))
        looks = chain(looked, repeat(found))
        monkeypatch.setattr(module, "look", lambda _p, _s: SimpleNamespace(fit=next(looks), left="something"))
        before = Decision(fit, {}, noise, left, s)
        p.warnings.clear()
        after, held = beside_unknown(p, s, before, fit_report(p, fit, "test"), lambda _text: None)
        return SimpleNamespace(same=after is before, fit=after.fit, left=after.left, held=held)

    def beside(functions, _p, _s, f, _at):
        told.append(f.hypothesis.terms)
        return functions, with_rubbing(f)

    def with_rubbing(f):
        return with_function(p.ctx, f, RUBS.term, RUBS.theta)

    searched_for = NOTHING
    return SimpleNamespace(of=ask, searched=searched, told=told, p=p, s=s)


def test_names_stay_where_no_force_explains_far_more(asked):
    assert asked.of([], [True, True], NOTHING).same
    assert asked.of([RUBS], [], NOTHING).same
    assert asked.of([RUBS], [False, True], NOTHING).same
    assert asked.of([RUBS], [True, False], NOTHING).same
    assert not asked.searched and not asked.p.warnings


def test_names_that_are_only_like_what_acts_go(asked):
    answer = asked.of([RUBS], [True, True], NOTHING)
    assert answer.fit is NOTHING and answer.left.fit is NOTHING
    assert answer.held.after.rms == fit_report(asked.p, NOTHING, "test").before.rms
    (warning,) = asked.p.warnings
    assert warning.startswith("actuator gain at motor: it is only like what acts")
    ((machine, search),) = asked.searched
    hypothesis, theta = machine.sim.always
    assert hypothesis.terms == (RUBS.term,) and search.sim is machine.sim is not asked.p.sim
    np.testing.assert_array_equal(theta, RUBS.theta)


def test_functions_are_told_again_beside_what_is_found_until_it_stays(asked):
    """Beside functions that stood for some of the damping too, a gain was found with it."""
    damping = fitted(asked.s, {DAMPING: [0.02]})
    both = fitted(asked.s, {DAMPING: [0.02], GAIN: [0.97]})
    answer = asked.of([RUBS], [True, True], damping, looked=[both, damping, damping])
    assert answer.fit is damping and len(asked.searched) == 1
    # at first alone and beside what was named, then beside what each look found
    assert asked.told[2:] == [both.hypothesis.terms, damping.hypothesis.terms]
    ((_, search),) = asked.searched
    assert search.resume.fit.hypothesis == damping.hypothesis


def test_what_never_stays_is_told_beside_the_last_functions(asked):
    gain, damping = fitted(asked.s, {GAIN: [0.97]}), fitted(asked.s, {DAMPING: [0.02]})
    answer = asked.of([RUBS], [True, True], gain, looked=[gain, damping, gain, damping])
    assert answer.fit is gain and len(asked.told) == 2 + module.ROUNDS - 1


@pytest.mark.parametrize("better", [True, False])
@pytest.mark.parametrize("much", [True, False])
def test_a_name_at_the_second_place_stays_unless_functions_at_both_predict_better(
    asked, monkeypatch, much, better
):
    """Damping is found beside a function at one place; with a second function in its place nothing is."""
    damping, second = fitted(asked.s, {DAMPING: [0.02]}), Function(Term("second", HINGE), np.zeros(1), None)
    tried = []

    def found_beside(_p, _s, functions, at, _say):
        tried.append((functions, at))
        fit = damping if functions == [RUBS] else NOTHING
        asked.p.warnings.append(str(len(functions)))
        return module._Beside(Decision(fit, {}, Floor(), None, asked.s), fit, much)

    monkeypatch.setattr(module, "_found_beside", found_beside)
    monkeypatch.setattr(module, "_far_better", lambda *_: True)
    monkeypatch.setattr(module, "functions_of_motion", lambda _p, _s, f, _at: ([RUBS, second], f))
    monkeypatch.setattr(module, "predicts_better", lambda _p, new, old: better and old is damping)
    found = Decision(fitted(asked.s, {GAIN: [0.9]}), {}, Floor(), None, asked.s)
    asked.p.warnings[:] = ["before"]
    answer = module._beside_functions(
        asked.p, asked.s, found, ["hinge", "other"], ["hinge"], lambda _text: None
    )
    assert tried[0] == ([RUBS], ["hinge"]) and tried[1:] == (
        [([RUBS, second], ["hinge", "other"])] if much else []
    )
    assert answer.fit is (NOTHING if much and better else damping)
    assert asked.p.warnings[:2] == ["before", "2" if much and better else "1"]
    assert len(asked.p.warnings) == 3 and asked.p.warnings[2].startswith("actuator gain at motor")


def test_far_better_takes_windows_enough_to_say_so(asked, monkeypatch):
    """Dry friction of 0.1 N m, beside a wrong gain."""
    p, right, wrong = asked.p, fitted(asked.s, {COULOMB: [0.1]}), fitted(asked.s, {GAIN: [0.9]})
    count = judged(p, "choice").count
    monkeypatch.setattr(module, "ENOUGH_WINDOWS", count)
    assert _far_better(p, right, wrong) and not _far_better(p, wrong, right)
    monkeypatch.setattr(module, "ENOUGH_WINDOWS", count + 1)
    assert not _far_better(p, right, wrong)


def test_what_is_found_beside_the_force_is_told_without_it(asked):
    damping = fitted(asked.s, {DAMPING: [0.02]})
    answer = asked.of([RUBS], [True, True], damping)
    assert answer.fit is damping and answer.left.fit is damping
    assert answer.held.after.rms == fit_report(asked.p, damping, "test").after.rms


def test_what_leaves_nothing_once_it_is_found_leaves_nothing(asked):
    friction = fitted(asked.s, {COULOMB: [0.1]})
    answer = asked.of([RUBS], [True, True], friction)
    assert answer.fit is friction and answer.left is None


@pytest.mark.parametrize("looked", [None, "something"])
@pytest.mark.parametrize("decided", [None, "something"])
def test_what_was_found_beside_it_may_leave_nothing_without_a_name(rubbing, monkeypatch, looked, decided):
    s, p = rubbing
    p.warnings[:] = ["before"]
    gain, friction = fitted(s, {GAIN: [0.9]}), fitted(s, {COULOMB: [0.1]})
    began = []

    def look(_p, search):
        began.append(search.resume.fit)
        return SimpleNamespace(left=looked)

    def decide(machine, search, _say, _looked):
        machine.warnings.append("left out")
        return Decision(friction, {}, Floor(), decided, search)

    monkeypatch.setattr(module, "look", look)
    monkeypatch.setattr(module, "decide", decide)
    monkeypatch.setattr(module, "tested", lambda _p, _s, decision: (decision, "held"))
    answer = module._nothing_unknown(p, s, Decision(gain, {}, Floor(), None, s), lambda _text: None)
    assert began == [gain]
    if looked is None and decided is None:
        assert answer[0].fit is friction and answer[1] == "held" and p.warnings == ["before", "left out"]
    else:
        assert answer is None and p.warnings == ["before"]


def test_a_name_that_is_found_again_is_not_said_to_be_left_out(asked):
    gain = fitted(asked.s, {GAIN: [0.95]})
    assert asked.of([RUBS], [True, True], gain).fit is gain and not asked.p.warnings


def test_where_nothing_was_named_any_clear_gain_is_enough(asked):
    assert not asked.of([RUBS], [False], NOTHING, fit=NOTHING).same
    assert len(asked.searched) == 1


def test_where_nothing_is_left_nothing_is_asked(rubbing, monkeypatch):
    s, p = rubbing
    monkeypatch.setattr(module, "functions_of_motion", None)
    f = fitted(s, {COULOMB: [0.1]})
    before, held = Decision(f, {}, Floor(), None, s), fit_report(p, f, "test")
    assert beside_unknown(p, s, before, held, lambda _text: None) == (before, held)


def test_terms_beside_a_machine_act_in_every_run(rubbing):
    s, p = rubbing
    damping, both = fitted(s, {DAMPING: [0.02]}), fitted(s, {DAMPING: [0.02], COULOMB: [0.1]})
    w, friction = s.held, fitted(s, {COULOMB: [0.1]})
    beside = p.sim.beside(friction.hypothesis, friction.theta)
    for alone, together in ((NOTHING, friction), (damping, both)):
        np.testing.assert_array_equal(
            beside.residuals([Run(alone.hypothesis, alone.theta)], w),
            p.sim.residuals([Run(together.hypothesis, together.theta)], w),
        )
    assert not p.sim.always[0].terms


@pytest.mark.slow
def test_crosstalk_of_drives_is_one_force_and_no_wrong_masses():
    """A share of one drive's force acts at the other joint. Offsets of masses and gains are like it a little."""
    motors = ARM.replace(
        '<position name="elbow_servo" joint="elbow" kp="8" kv="0.4"/>', '<motor name="elbow" joint="elbow"/>'
    )

    def crosstalk(_model, data):
        data.qfrc_applied[1] = 0.06 * data.ctrl[0]

    def rubs(model):
        model.dof_frictionloss[0] = 0.15

    some = Config(effects=("coulomb_friction", "viscous_damping", "com_offset", "actuator_gain"), jobs=1)
    recordings = record(motors, [4.0, 0.8], change=rubs, force=crosstalk, seconds=3.0)
    found = diagnose(mujoco.MjSpec.from_string(motors), recordings, some).to_json()
    assert found["verdict"] == "unexplained"
    assert [(e["id"], e["at"]) for e in found["effects"]] == [("coulomb_friction", "shoulder")]
    assert found["residual"]["at"] == ["elbow"] and found["residual"]["inputs"] == ["f:shoulder"]
    assert "0.06" in found["residual"]["formula"] and "f(shoulder)" in found["residual"]["formula"]
    assert found["residual"]["held_out"]["after"] < 0.2 * found["residual"]["held_out"]["before"]


def test_what_goes_with_an_effect_is_told_beside_the_function(rubbing):
    """Damping for what is dry friction: beside that friction as a function, damping makes the error larger."""
    s, p = rubbing
    damping, w = fitted(s, {DAMPING: [0.02]}), judged(p, "test")
    both, alone = (with_function(p.ctx, f, RUBS.term, RUBS.theta) for f in (damping, NOTHING))
    with_it, without = (errors(p.sim, f, w, p.noise, near=both).rms for f in (both, alone))
    assert error_drops(p, both, w, damping.hypothesis.terms) == pytest.approx(
        {DAMPING: 1 - with_it**2 / without**2}
    )
    assert error_drops(p, both, w, [DAMPING])[DAMPING] < 0.0 < error_drops(p, damping, w, [DAMPING])[DAMPING]
