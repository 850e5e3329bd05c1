"""Effects that only do harm once a function stands for what has no name."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.estimation.prediction_error import Errors, errors
from mpge_jax.diagnosis.evidence.held_out_error import fit_report
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.residual.model import Function, ResidualModel, with_residual
from mpge_jax.diagnosis.selection.procedure import Decision, what_is_left
from mpge_jax.diagnosis.verdict import beside_functions as module
from mpge_jax.diagnosis.verdict import judgement
from mpge_jax.diagnosis.verdict.beside_functions import HARM, without_needless
from tests.diagnosis.machines import PENDULUM
from tests.diagnosis.searches import COULOMB, DAMPING, GAIN, HINGE, fitted

SPEED = Residual((Axis("v", -4.0, 4.0),), 4.0)


def _rubs(torque: float) -> Function:
    """Dry friction (N m) as a function of speed, as smooth as such functions are."""
    return Function(Term(SPEED.id, HINGE), -torque * np.tanh(9.0 * np.linspace(-1, 1, 9)), None)


@pytest.fixture
def asked(rubbing, plain_functions):
    """What stays of effects on a pendulum with dry friction of 0.1 N m, beside a function for some of it."""
    s, p = rubbing
    p.warnings.clear()

    def told(f, torque: float):
        held = fit_report(p, f, "test")
        alone = ResidualModel((_rubs(torque),), held.after.rms, 0.0)
        both = errors(p.sim, with_residual(p.ctx, f, alone), held.windows, p.noise).rms
        return ResidualModel(alone.functions, held.after.rms, both), held

    def ask(named, torque: float, doubtful=()):
        found = Decision(fitted(s, named), {t: [] for t in named}, Floor(), None, s)
        return without_needless(p, s, found, ["hinge"], *told(found.fit, torque), doubtful)[0], found

    return SimpleNamespace(told=told, of=ask, p=p, s=s)


def test_what_makes_the_error_larger_beside_the_function_goes(asked):
    """Damping was taken for the friction: with a function for that there is too much of it."""
    ask, p = asked.of, asked.p
    after, found = ask({DAMPING: [0.02]}, 0.1)
    assert after is not found and not after.fit.hypothesis.terms and not after.rivals
    assert after.left is not None
    assert p.warnings == [f"viscous damping at hinge: {HARM}; it is left out."]


def test_what_still_helps_beside_the_function_stays(asked):
    ask, p = asked.of, asked.p
    after, found = ask({COULOMB: [0.05]}, 0.05)
    assert after is found and not p.warnings


def test_one_goes_at_a_time_and_the_others_are_fitted_again(asked):
    """Half of the friction has its name, and the function stands for the other half: a gain that is too small does
    nothing but harm."""
    ask, p = asked.of, asked.p
    after, _ = ask({COULOMB: [0.05], GAIN: [0.95]}, 0.05)
    assert after.fit.hypothesis.terms == (COULOMB,) and list(after.rivals) == [COULOMB]
    assert len(p.warnings) == 1 and p.warnings[0].startswith("actuator gain at motor")


def test_what_may_be_a_part_of_it_goes_where_the_function_alone_predicts_far_better(asked):
    """Damping is only like the friction, half of which the function stands for: it helps, until the function stands for
    all of it."""
    ask, p = asked.of, asked.p
    assert ask({DAMPING: [0.004]}, 0.05)[0].fit.hypothesis.terms == (DAMPING,)
    after, _ = ask({DAMPING: [0.004]}, 0.05, [DAMPING])
    assert not after.fit.hypothesis.terms and p.warnings == [
        f"viscous damping at hinge: {HARM}; it is left out."
    ]


@pytest.mark.parametrize("share", [0.05, 0.09])
def test_what_may_be_a_part_of_it_stays_where_the_function_alone_predicts_as_well_as_both(asked, share):
    ask, p = asked.of, asked.p
    after, found = ask({COULOMB: [share]}, 0.1 - share, [COULOMB])
    assert after is found and not p.warnings


def test_it_stays_where_functions_beside_fewer_effects_predict_worse(asked, monkeypatch):
    ask, p = asked.of, asked.p
    for its in (None, ResidualModel((), 1.0, 1e6)):
        monkeypatch.setattr(module, "residual_of_motion", lambda *_, its=its: its)
        after, found = ask({DAMPING: [0.02]}, 0.1)
        assert after is found and not p.warnings


def test_the_verdict_is_told_without_it(asked, monkeypatch):
    p, s, damping = asked.p, asked.s, fitted(asked.s, {DAMPING: [0.02]})
    residual, held = asked.told(damping, 0.1)
    monkeypatch.setattr(judgement, "residual_of_motion", lambda *_: residual)
    found = Decision(damping, {DAMPING: []}, *what_is_left(p, damping, s), s)
    result = judgement.judge(p, mujoco.MjModel.from_xml_string(PENDULUM), s, found, held, None)
    assert result.verdict == "unexplained" and not result.fit.hypothesis.terms
    assert result.held.after.rms == result.held.before.rms and result.error_drop == {}


def test_what_names_were_given_up_for_matters_however_slight_it_is(asked, monkeypatch):
    """And its functions are those beside which the others were fitted: what is left is modelled no second time."""
    p, s, damping = asked.p, asked.s, fitted(asked.s, {DAMPING: [0.02]})
    residual, held = asked.told(damping, 0.1)
    told, modelled = iter([True, False]), iter([residual])
    beside: list[ResidualModel] = []
    own = module.residual_of_motion
    monkeypatch.setattr(judgement, "matters", lambda *_: next(told))
    monkeypatch.setattr(judgement, "residual_of_motion", lambda *_: next(modelled))
    monkeypatch.setattr(module, "residual_of_motion", lambda *given: beside.append(own(*given)) or beside[-1])
    found = Decision(damping, {DAMPING: []}, *what_is_left(p, damping, s), s)
    result = judgement.judge(p, mujoco.MjModel.from_xml_string(PENDULUM), s, found, held, None)
    assert result.verdict == "unexplained" and not result.fit.hypothesis.terms
    assert result.residual is beside[-1] and result.residual.before == result.held.after.rms


def test_what_is_told_at_one_joint_is_not_drowned_by_the_unknown_at_another():
    """Rotor inertia takes a tenth's error away at its joint, while what has no name is missed by more elsewhere."""
    without = Errors(0.25, np.array([0.02, 0.35, np.nan]), np.zeros(1), np.zeros((1, 1, 3)))
    both = Errors(0.26, np.array([0.002, 0.37, np.nan]), np.zeros(1), np.zeros((1, 1, 3)))
    assert both.rms > without.rms
    assert module._falls(without, both) == pytest.approx(0.5 * (np.log(10.0) - np.log(37 / 35)))
