"""Which of those that tie are listed."""

from __future__ import annotations

from types import SimpleNamespace

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.evidence.scored import Rival
from mpge_jax.diagnosis.verdict.result import CANDIDATES, candidates_of


def of(effect: str, body: int = 0) -> tuple[Term, Fitted]:
    term = Term(effect, Place("body", f"body_{body}", body))
    return term, Fitted(Hypothesis.of(term), NOTHING.theta, NOTHING.centre)


def test_one_of_each_effect_is_listed_before_others_of_the_same():
    chosen, fit = of("actuator_bias")
    near = [of("external_force", 1), of("external_force", 2), of("external_force", 3), of("gravity_tilt")]
    rivals = [Rival(term, f, 0.0, "", tied=True) for term, f in near]
    rivals.insert(0, Rival(*of("joint_stiffness"), 0.0, ""))
    d = SimpleNamespace(fit=fit, rivals={chosen: rivals, near[0][0]: []})
    assert CANDIDATES == 4
    assert candidates_of(d) == {chosen: [fit, near[0][1], near[3][1], near[1][1]]}


def test_the_chosen_effect_is_one_of_its_own():
    chosen, fit = of("external_force", 1)
    near = [of("external_force", 2), of("actuator_bias"), of("gravity_tilt"), of("joint_stiffness")]
    d = SimpleNamespace(fit=fit, rivals={chosen: [Rival(term, f, 0.0, "", tied=True) for term, f in near]})
    assert candidates_of(d) == {chosen: [fit, *(f for _, f in near[1:])]}
