"""What no effect explains is modelled from the motion, and makes recordings better predicted that it never saw."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.family import residual_of
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.prediction_error import errors
from mpge_jax.diagnosis.evidence.held_out_error import fit_report
from mpge_jax.diagnosis.residual import motion, roll_out
from mpge_jax.diagnosis.residual.inputs import places_of, seen
from mpge_jax.diagnosis.residual.model import Function, with_function
from mpge_jax.diagnosis.residual.motion import residual_of_motion
from mpge_jax.diagnosis.residual.regression import Blocks, Choice
from tests.diagnosis.machines import FINE_PENDULUM, PENDULUM, really_sticks, record
from tests.diagnosis.searches import COULOMB, GAIN, HINGE, fitted, search_of


@pytest.fixture(scope="module")
def grinding():
    """Damping that depends on the angle: nothing in the vocabulary is like it."""

    def force(_model, data):
        data.qfrc_applied[0] = -0.3 * data.qvel[0] * np.sin(data.qpos[0]) ** 2

    return search_of(PENDULUM, record(PENDULUM, 0.8, force=force, count=4, seconds=2.5))


@pytest.mark.slow
def test_a_law_of_angle_and_speed_is_learned(grinding):
    s, p = grinding
    held = fit_report(p, NOTHING, "test")
    found = residual_of_motion(p, s, NOTHING, ["hinge"], (p, NOTHING), held)
    assert found is not None and found.before == held.after.rms and found.after < 0.2 * found.before
    (function,) = found.functions
    assert "v" in [a.input for a in function.axes] and function.term.place == HINGE


@pytest.mark.slow
def test_dry_friction_that_depends_on_the_angle_is_learned():
    def force(model, data):
        model.dof_frictionloss[0] = 0.1 * (1.0 + np.tanh(4.0 * data.qpos[0]))
        really_sticks(model, 0)

    s, p = search_of(PENDULUM, record(PENDULUM, 0.35, force=force, count=4, seconds=2.5))
    held = fit_report(p, NOTHING, "test")
    found = residual_of_motion(p, s, NOTHING, ["hinge"], (p, NOTHING), held)
    assert found is not None and found.after < 0.5 * found.before
    (function,) = found.functions
    # a pendulum's angle and the force of gravity on it say the same
    assert residual_of(function.term.id).dry and {"q", "l"} & {a.input for a in function.axes}


@pytest.mark.slow
def test_a_spring_that_yields_and_remembers_is_learned():
    """Bouc and Wen's: neither position nor speed tell its force."""
    bent = [0.0]

    def force(model, data):
        v = float(data.qvel[0])
        pulling = 1.0 if v * bent[0] > 0 else 0.0
        bent[0] += model.opt.timestep * v * (1.0 - (bent[0] / 0.15) ** 2 * pulling)
        data.qfrc_applied[0] = -1.5 * bent[0]

    s, p = search_of(PENDULUM, record(PENDULUM, 0.35, force=force, count=4, seconds=2.5))
    held = fit_report(p, NOTHING, "test")
    found = residual_of_motion(p, s, NOTHING, ["hinge"], (p, NOTHING), held)
    assert found is not None and found.after < 0.5 * found.before
    (function,) = found.functions
    assert [a.input for a in function.axes] == ["z"] and 0.07 < function.axes[0].high < 0.3


@pytest.mark.slow
def test_notches_of_a_wheel_are_learned():
    """A ball that a spring presses into five notches of a wheel: narrow, and the same at each."""

    def force(_model, data):
        beside = (data.qpos[0] - 0.3 + np.pi / 5) % (2 * np.pi / 5) - np.pi / 5
        data.qfrc_applied[0] = -2.0 * beside * np.exp(-0.5 * (beside / 0.08) ** 2)

    wheel = FINE_PENDULUM.replace("0 0 0 0 0 -.3", "0 0 .15 0 0 -.15").replace(
        'damping="0.02"', 'damping="0.08"'
    )
    s, p = search_of(wheel, record(wheel, 0.4, force=force, count=4, seconds=4.0))
    held = fit_report(p, NOTHING, "test")
    found = residual_of_motion(p, s, NOTHING, ["hinge"], (p, NOTHING), held)
    assert found is not None and found.after < 0.2 * found.before
    ((axis,),) = (function.axes for function in found.functions)
    assert axis.around and axis.parts == 5


def test_what_acts_in_few_windows_is_learned():
    """A stop that brakes: beside the usual window, which lacks nothing, those that reach it are odd."""

    def force(_model, data):
        data.qfrc_applied[0] = -2.0 * max(data.qvel[0], 0.0) * (data.qpos[0] > 0.7)

    recordings = record(PENDULUM, 0.5, force=force, count=6, seconds=4.0)
    assert np.mean([np.mean(r.qpos > 0.7) for r in recordings]) < 0.1
    s, p = search_of(PENDULUM, recordings)
    held = fit_report(p, NOTHING, "test")
    found = residual_of_motion(p, s, NOTHING, ["hinge"], (p, NOTHING), held)
    assert found is not None and found.after < 0.5 * found.before


def test_functions_are_judged_by_recordings_that_they_were_not_fitted_to(rubbing, monkeypatch):
    """Parts of one recording are much alike: what is told of one part is known of the other."""
    s, p = rubbing
    p, folds = p.all_to_train(), []
    monkeypatch.setattr(motion, "told", lambda _candidates, fold: folds.append(fold) or [])
    assert motion.functions_of_motion(p, s, NOTHING, ["hinge"]) == ([], NOTHING)
    w = p.windows("train", p.config.decide_s, motion.WINDOWS, seed=17)
    logs = np.array([source.recording.log for source in w.sources])[w.source]
    assert len(w.sources) > len(set(logs)) >= 3
    for fold in folds:
        assert len({*zip(logs, fold, strict=True)}) == len(set(logs)) == len(set(fold))


@pytest.mark.parametrize(("width", "values"), [(1.0, 9), (0.05, 36)])
def test_windows_tell_how_fine_a_function_is(width, values):
    """A pull towards an angle, from near it or from everywhere."""
    rng, effect = np.random.default_rng(0), Residual((Axis("q", -1.0, 1.0),), 3.0)
    q = rng.uniform(-1.0, 1.0, (60, 30))
    left = np.exp(-((q / width) ** 2)) + 0.01 * rng.standard_normal(q.shape)
    answers = SimpleNamespace(of=lambda e: Blocks.of(np.array(e.basis(np, [q])), left, np.ones(60)))
    found = Choice(effect, HINGE.index, np.zeros(9), np.zeros(60), 1.0)
    chosen = motion.as_fine_as_shown(found, answers, np.arange(60) % 5)
    assert chosen.effect.counts == (values,) and chosen.values.size == values


def test_where_nothing_is_left_there_is_no_function(rubbing):
    s, p = rubbing
    f = fitted(s, {COULOMB: [0.1]})
    held = fit_report(p, f, "test")
    assert residual_of_motion(p, s, f, ["hinge"], (p, f), held) is None
    assert residual_of_motion(p, s, f, ["no joint"], (p, f), held) is None


def test_it_is_judged_on_the_machine_whose_errors_are_shown(rubbing, monkeypatch):
    """A machine that measured forces drive may be shown driven by its commands, with what was found between the two."""
    s, p = rubbing
    effect = Residual((Axis("v", -3.0, 3.0),), 3.0)
    term, theta = Term(effect.id, HINGE), -0.1 * np.sign(np.linspace(-1, 1, 9))
    function = Function(term, theta, None)
    monkeypatch.setattr(
        motion,
        "functions_of_motion",
        lambda _p, _s, f, _at: ([function], with_function(p.ctx, f, term, theta)),
    )
    weak = fitted(s, {GAIN: [0.9]})
    held = fit_report(p, weak, "test")
    with monkeypatch.context() as away:
        away.setattr(motion, "staying", lambda *_: 0)
        assert residual_of_motion(p, s, NOTHING, ["hinge"], (p, weak), held) is None
    found = residual_of_motion(p, s, NOTHING, ["hinge"], (p, weak), held)
    want = errors(p.sim, with_function(p.ctx, weak, term, theta), held.windows, p.noise).rms
    assert found.before == held.after.rms and found.after == want < found.before
    assert (
        found.after
        > 2.0 * errors(p.sim, with_function(p.ctx, NOTHING, term, theta), held.windows, p.noise).rms
    )


def test_places_are_joints_or_those_that_actuators_drive(rubbing):
    _, p = rubbing
    assert places_of(p, ["motor", "hinge", "arm"]) == [HINGE]
    values = seen(p, HINGE)
    assert {key[0] for key in values} == set("qvflz") and len({len(x) for x in values.values()}) == 1
    # the motor's force is its command, and the arm's weight is what the other links are
    np.testing.assert_allclose(values["l"], -0.5 * 9.81 * 0.15 * np.sin(values["q"]), rtol=1e-3, atol=1e-6)


def test_a_force_that_drives_a_joint_on_does_not_run_away(rubbing, monkeypatch):
    _, p = rubbing
    effect = Residual((Axis("v", -3.0, 3.0),), 3.0)
    drives = with_function(p.ctx, NOTHING, Term(effect.id, HINGE), 0.5 * np.linspace(-1, 1, 9))
    speeds = roll_out.greatest_speeds(p, [NOTHING, drives])
    assert speeds.shape == (2, 1) and speeds[1, 0] < 40.0
    away, gone = np.array([[2.0], [300.0]]), np.array([[2.0], [np.inf]])
    for told, kept in ((speeds, 1), (away, 0), (gone, 0)):
        monkeypatch.setattr(roll_out, "greatest_speeds", lambda *_, told=told: told)
        assert roll_out.staying(p, [NOTHING, drives]) == kept
    # what comes after one that runs away does not stay either
    monkeypatch.setattr(roll_out, "greatest_speeds", lambda *_: np.array([[2.0], [3.0], [300.0], [300.0]]))
    assert roll_out.staying(p, [NOTHING] * 4) == 1
    # what does not stay in larger steps may do so in the model's own
    asked = []

    def told(_p, fits, cheaply):
        asked.append(cheaply)
        return np.array([[2.0], [300.0 if cheaply else 3.0]])

    monkeypatch.setattr(roll_out, "greatest_speeds", told)
    coarse = replace(p, sim=replace(p.sim, stride=2))
    assert roll_out.staying(coarse, [NOTHING, drives]) == 1 and asked == [True, False]
