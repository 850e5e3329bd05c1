"""What acts at other joints than the one at which something has no name."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.selection.procedure import Decision, Look
from mpge_jax.diagnosis.verdict import elsewhere as module
from mpge_jax.diagnosis.verdict.elsewhere import elsewhere
from tests.diagnosis.machines import ARM, PENDULUM, record
from tests.diagnosis.searches import fitted, prepared_of, search_of

SHOULDER, ELBOW = Place("joint", "shoulder", 0), Place("joint", "elbow", 1)
RUBS, LOAD = Term("coulomb_friction", ELBOW), Term("com_offset", Place("body", "fore", 2))
CREEPS = Term("coulomb_friction:creeping", ELBOW)
"""As MuJoCo's own dry friction, which acts there, does."""
DAMPED = Term("viscous_damping", SHOULDER)
QUIET = lambda _text: None  # noqa: E731


def _hidden(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """A torque at the shoulder that depends on nothing that is recorded."""
    data.qfrc_applied[0] = 1.2 * np.sin(9 * data.time + 3 * np.sin(2.3 * data.time))


def _rubbing(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[1] = 0.15


@pytest.fixture(scope="module")
def arm():
    """An arm that rubs at its elbow while something unknown acts at its shoulder."""
    recordings = record(ARM, [1.0, 0.6], change=_rubbing, force=_hidden, count=5, seconds=3.0)
    s, p = search_of(ARM, recordings)
    p = dataclasses.replace(
        p, config=dataclasses.replace(p.config, effects=("coulomb_friction", "com_offset", "armature"))
    )
    return s, p


def test_friction_at_the_elbow_is_told_beside_an_unknown_force_at_the_shoulder(arm):
    s, p = arm
    p.warnings[:] = ["before"]
    wrong = fitted(s, {LOAD: [0.03, 0.0, 0.02], DAMPED: [0.2]})
    wrong = dataclasses.replace(wrong, cov=np.diag([4.0, 4.0, 4.0, 9.0]))
    answer = elsewhere(p, s, Decision(wrong, {LOAD: [], DAMPED: []}, Floor(), None, s), ["shoulder"], QUIET)
    assert answer is not None and set(answer.fit.hypothesis.terms) == {CREEPS, DAMPED}
    parts = answer.fit.hypothesis.split(p.ctx, answer.fit.theta)
    assert parts[CREEPS] == pytest.approx(0.15, rel=0.1) and parts[DAMPED] == 0.2
    rubs, damped = (
        answer.fit.hypothesis.slices(p.ctx)[answer.fit.hypothesis.terms.index(t)] for t in (CREEPS, DAMPED)
    )
    assert answer.fit.cov[damped, damped] == 9.0 and (answer.fit.cov[damped, rubs] == 0.0).all()
    assert 0.0 < answer.fit.cov[rubs, rubs] < 0.01**2
    # what is unknown is still left, and what was only like it is said to have gone
    assert answer.left is not None and set(answer.rivals) >= {DAMPED} and LOAD not in answer.rivals
    first, *_, last = p.warnings
    assert first == "before" and last.startswith(
        "com offset at fore: it is only like what acts at the shoulder"
    )


def _answers(monkeypatch, *left: tuple[bool, bool]) -> list[tuple[int, bool]]:
    """Makes what searches find leave something or not, before and after alternatives are weighed, one search after the
    other; returns which degrees of freedom were guided, and whether alternatives were weighed."""
    asked, answers = [], iter(left)

    def look(machine, search):
        asked.append((*machine.sim.guided, False))
        before, after = next(answers)
        search.leaves = after
        return Look(NOTHING, Floor(), object() if before else None, (), [])

    def decide_roughly(machine, search, looked):
        assert looked.left is None
        asked[-1] = (*machine.sim.guided, True)
        return Decision(NOTHING, {}, Floor(), object() if search.leaves else None, search)

    monkeypatch.setattr(module, "look", look)
    monkeypatch.setattr(module, "decide_roughly", decide_roughly)
    monkeypatch.setattr(module, "tested", lambda _machine, _search, found: (found, None))
    return asked


def test_joints_are_tried_until_nothing_is_left_of_the_others(arm, monkeypatch):
    s, p = arm
    found = Decision(NOTHING, {}, Floor(), None, s)
    p.warnings[:] = ["before"]
    monkeypatch.setattr(module, "_tells_more", lambda *_: True)
    monkeypatch.setattr(module, "much_is_left", lambda _machine, _search, others: others.left is not None)
    asked = _answers(monkeypatch, (True, False), (False, False), (True, True), (False, True))
    answer = elsewhere(p, s, found, ["elbow", "elbow_servo", "shoulder"], QUIET)
    # alternatives are not weighed of what leaves much before that
    assert answer is not None and answer.fit is NOTHING and asked == [(1, False), (0, True)]
    asked.clear()
    assert elsewhere(p, s, found, ["elbow", "shoulder"], QUIET) is None
    assert asked == [(1, False), (0, True)] and p.warnings == ["before"]


def test_what_a_search_elsewhere_does_not_find_stays_unless_it_tells_the_motion_better(arm, monkeypatch):
    s, p = arm
    p.warnings[:] = ["before"]
    _answers(monkeypatch, (False, False), (False, False))
    rubs, nothing = (Decision(f, {}, Floor(), None, s) for f in (fitted(s, {RUBS: [0.1]}), NOTHING))
    # nothing is found while the shoulder moves as recorded: the friction that is there is not spoken against
    assert elsewhere(p, s, rubs, ["shoulder"], QUIET) is None
    assert elsewhere(p, s, nothing, ["shoulder"], QUIET) is None
    assert p.warnings == ["before"]


def test_what_acts_at_the_guided_joint_alone_is_not_looked_for(arm, monkeypatch):
    s, p = arm
    seen: list[Hypothesis] = []
    _answers(monkeypatch, (False, False))
    look = module.look
    monkeypatch.setattr(module, "look", lambda p, search: (seen.append(search.terms), look(p, search))[1])
    elsewhere(p, s, Decision(NOTHING, {}, Floor(), None, s), ["shoulder"], QUIET)
    (terms,) = seen
    assert RUBS in terms and LOAD in terms
    assert not any(t.place.name == "shoulder" for t in terms)


def test_a_machine_with_one_joint_has_no_other_joints():
    p = prepared_of(PENDULUM, record(PENDULUM, 0.8))
    assert elsewhere(p, None, None, ["hinge"], QUIET) is None


BESIDE = ARM.replace(
    "</worldbody>",
    '<body name="other" pos="0 1 0"><joint name="swing" axis="0 1 0" damping="0.05"/>'
    '<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1" contype="0" conaffinity="0"/></body></worldbody>',
).replace("</actuator>", '<motor name="swing_motor" joint="swing"/></actuator>')
SWINGS, SHARED = (
    Term("coulomb_friction", Place("joint", "swing", 2)),
    Term("mass_scale", Place("world", "world", 0)),
)


def test_joints_of_other_trees_move_as_recorded_too_and_what_was_found_there_stays(monkeypatch):
    """An arm and a pendulum that do not move each other."""
    s, p = search_of(BESIDE, record(BESIDE, [1.0, 0.6, 0.8], count=3, seconds=1.5))
    found = dataclasses.replace(
        fitted(s, {SWINGS: [0.05], SHARED: [1.1], LOAD: [0.03, 0.0, 0.02]}), cov=np.eye(5)
    )
    rubs, seen = dataclasses.replace(fitted(s, {RUBS: [0.1]}), cov=np.eye(1)), []

    def look(machine, search):
        seen.append((machine.sim.guided, machine.sim.always[0].terms, search.terms))
        return Look(rubs, Floor(), None, (), [])

    monkeypatch.setattr(module, "look", look)
    monkeypatch.setattr(module, "decide_roughly", lambda _p, s, _looked: Decision(rubs, {}, Floor(), None, s))
    monkeypatch.setattr(module, "tested", lambda _p, _s, decision: (decision, None))
    monkeypatch.setattr(module, "_tells_more", lambda _s, new, old: old.hypothesis.terms == (LOAD,))
    answer = elsewhere(p, s, Decision(found, {}, Floor(), None, s), ["swing", "shoulder"], QUIET)
    # nothing hangs on the pendulum's joint
    ((guided, known, terms),) = seen
    assert guided == (0, 2) and set(known) == {SWINGS, SHARED}
    assert RUBS in terms and LOAD in terms and not {SWINGS, SHARED} & set(terms)
    assert not any(t.place.name in ("shoulder", "swing") for t in terms)
    assert answer is not None and set(answer.fit.hypothesis.terms) == {SWINGS, SHARED, RUBS}


@pytest.mark.parametrize(
    "coupling",
    [
        '<equality><joint joint1="elbow" joint2="swing"/></equality>',
        '<tendon><fixed name="rope"><joint joint="elbow" coef="1"/><joint joint="swing" coef="1"/></fixed></tendon>',
    ],
)
def test_trees_that_something_couples_are_one(coupling):
    model = mujoco.MjModel.from_xml_string(BESIDE.replace("<actuator>", coupling + "<actuator>"))
    assert module._with_those_it_does_not_move(model, 0) == [0]
    assert module._with_those_it_does_not_move(mujoco.MjModel.from_xml_string(BESIDE), 0) == [0, 2]
