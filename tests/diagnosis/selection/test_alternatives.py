"""One effect in place of several."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.evidence.scored import Rival
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.selection import alternatives
from mpge_jax.diagnosis.selection.alternatives import better_rival, find_rivals, unaffected
from mpge_jax.diagnosis.selection.backward_elimination import final_fit, prune
from mpge_jax.diagnosis.selection.procedure import Decision, with_fewer
from tests.diagnosis.machines import ARM, FINE_ARM, PENDULUM, really_sticks, record
from tests.diagnosis.searches import ARMATURE, COULOMB, DAMPING, GAIN, HINGE, MOTOR, fitted, search_of

BIAS, BY_DIRECTION = Term("actuator_bias", MOTOR), Term("asymmetric_friction", HINGE)


ON_AN_AXIS = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body name="arm"><joint name="arm" axis="0 0 1" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".6" contype="0" conaffinity="0"/>
<body name="rod" pos=".2 0 0"><joint name="rod" axis="1 0 0" damping="0.002"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".01" mass=".15" contype="0" conaffinity="0"/></body></body>
</worldbody><actuator><motor name="motor" joint="arm"/></actuator></mujoco>"""


def _settled(change, *terms: Term) -> Hypothesis:
    """What is left of some effects of a motor's joint once a better rival has taken the place of one."""
    s, _ = search_of(PENDULUM, record(PENDULUM, 0.8, change=change[0], force=change[1], seconds=3.0))
    f, whites = final_fit(s, fitted(s, {t: [0.03] for t in terms}))
    better = better_rival(find_rivals(s, s.score([f], whites)[0], whites, []))
    return f.hypothesis if better is None else prune(s, better.fit).hypothesis


def _rubbing(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[0] = 0.06
    really_sticks(model, 0)


def test_friction_that_differs_by_direction_takes_the_place_of_friction_and_a_bias_of_the_drive(monkeypatch):
    """0.06 N m and a push of 0.03 N m while it moves, and damping of 0.02 forwards, 0.1 N m s/rad backwards."""

    def force(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        v = float(data.qvel[0])
        data.qfrc_applied[0] += -0.02 * v if v > 0 else -0.1 * v
        # nothing pushes while it stands
        data.qfrc_applied[0] += 0.03 * min(abs(v) / 1e-3, 1.0)

    # as where only few windows are missed, in a large machine
    monkeypatch.setattr(alternatives, "SETTLED", np.inf)
    assert _settled((_rubbing, force), COULOMB, DAMPING, BIAS).terms == (BY_DIRECTION,)


def test_friction_beside_a_bias_stays_what_it_is():
    def force(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[0] += 0.05

    assert set(_settled((_rubbing, force), COULOMB, BIAS).terms) == {BIAS, COULOMB}


def test_of_two_that_explain_as_much_the_one_with_fewer_effects_is_told():
    """Beside dry friction a bias of the drive is sure (20 deviations), beside damping it may be none (1)."""
    ctx = nominal_context(mujoco.MjModel.from_xml_string(PENDULUM))
    s = SimpleNamespace(sim=SimpleNamespace(ctx=ctx))

    def told(law: Term, bias: float) -> Fitted:
        h = Hypothesis.of(law, BIAS)
        theta = h.gather(ctx, {law: np.array([0.1]), BIAS: np.array([bias])})
        return Fitted(h, theta, theta, cov=np.diag([1e-3**2] * 2))

    best = told(COULOMB, 0.02)
    assert alternatives._needs_fewer(s, best, told(DAMPING, 0.001), COULOMB)
    assert not alternatives._needs_fewer(s, best, told(DAMPING, 0.02), COULOMB)
    assert not alternatives._needs_fewer(s, told(COULOMB, 0.001), told(DAMPING, 0.001), COULOMB)


def test_a_payload_takes_the_place_of_one_at_the_next_body_and_of_what_stood_beside_it():
    """Beside the axis of the upper arm, near the elbow: on the forearm, where it turns with that, it needs a shifted
    encoder."""

    def carrying(model: mujoco.MjModel) -> None:
        body, mass, at = model.body("upper").id, 0.4, np.array([0.03, 0.0, -0.29])
        m, centre = model.body_mass[body], model.body_ipos[body].copy()
        new = (m * centre + mass * at) / (m + mass)
        for what, x in ((m, centre), (mass, at)):
            d = x - new
            model.body_inertia[body] += what * (d @ d - d**2)
        model.body_mass[body], model.body_ipos[body] = m + mass, new

    s, _ = search_of(FINE_ARM, record(FINE_ARM, [2.0, 0.8], change=carrying))
    wrong = {str(t): t for t in s.terms}
    fore, off = wrong["payload_mass@fore"], wrong["encoder_offset@shoulder"]
    f, whites = final_fit(s, fitted(s, {fore: [0.4, 0.0, 0.0, 0.0], off: [-0.02]}))
    better = better_rival(find_rivals(s, s.score([f], whites)[0], whites, []))
    assert better is not None and str(better.term) == "payload_mass@upper"
    (left,) = prune(s, better.fit).hypothesis.terms
    assert str(left) == "payload_mass@upper"


def test_what_does_the_same_is_compared_where_it_does():
    """On a vertical axis a mass farther out is rotor inertia. While that is told from nothing on, factors of given
    masses give way."""

    def heavier(model: mujoco.MjModel) -> None:
        model.dof_armature[0] += 0.004

    s, _ = search_of(ON_AN_AXIS, record(ON_AN_AXIS, [0.3], change=heavier, count=4))
    names, ctx = {str(t): t for t in s.terms}, s.sim.ctx
    offset, armature = names["com_offset@arm"], names["armature@arm"]
    given = next(t for t in s.terms if not t.effect.named)
    nothing = given.effect.null(ctx, given.place)
    best, whites = final_fit(s, fitted(s, {offset: [0.03, 0.0, 0.0], given: list(nothing)}))
    sample = s.train, whites[0]
    yielding = fitted(s, {armature: [0.001], given: [1.08, 1.09, *nothing[2:]]})
    yielding = fit(s.sim, [yielding], *sample, iterations=0)[0]
    (told,) = alternatives._beside_the_same(s, best, [yielding], sample)
    parts, known = (f.hypothesis.split(ctx, f.theta) for f in (told, best))
    np.testing.assert_array_equal(parts[given], known[given])
    assert parts[armature] == pytest.approx(0.004, rel=0.1)
    # what needs the others to be as they are stays
    other = fitted(s, {armature: [0.004], given: [1.0, 1.0, 1.0, 0.8]})
    (kept,) = alternatives._beside_the_same(s, other, [best], sample)
    assert kept is best
    same = {r.term: r for r in find_rivals(s, s.score([best], whites)[0], whites, [])[offset]}[armature]
    assert same.tied


def _on_an_arm(*names: str) -> Hypothesis:
    joints = {"shoulder": Place("joint", "shoulder", 0), "elbow": Place("joint", "elbow", 1)}
    world = {"world": Place("world", "world", 0)}
    places = (name.partition("@") for name in names)
    return Hypothesis.of(*(Term(effect, (joints | world)[at]) for effect, _, at in places))


@pytest.mark.parametrize(
    ("instead", "many", "tied", "stand"),
    [
        ("viscous_damping@elbow", True, False, {"coulomb_friction@shoulder"}),
        ("viscous_damping@elbow", True, True, set()),
        ("viscous_damping@elbow", False, False, set()),
        ("gravity_tilt@world", True, False, set()),
    ],
    ids=["at the same joint", "one that tied", "beside few", "everywhere"],
)
def test_alternatives_stand_at_joints_where_nothing_else_acts_now(instead, many, tied, stand):
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(ARM)))
    s = SimpleNamespace(sim=SimpleNamespace(ctx=ctx), brief=lambda _h: many)
    old = _on_an_arm("coulomb_friction@shoulder", "coulomb_friction@elbow", "armature@elbow")
    new = _on_an_arm("coulomb_friction@shoulder", "coulomb_friction@elbow", instead)
    rivals = {t: [Rival(t, NOTHING, 9.0, "", tied=tied)] for t in old.terms}
    assert set(map(str, unaffected(s, rivals, old, new))) == stand


def test_alternatives_that_stand_are_not_weighed_again(rubbing_finely, monkeypatch):
    s, _ = rubbing_finely
    f, whites = final_fit(s, fitted(s, {COULOMB: [0.1]}))
    stands = {COULOMB: [Rival(ARMATURE, f, 9.0, "as before")]}
    monkeypatch.setattr(s, "say", pytest.fail)
    assert find_rivals(s, s.score([f], whites)[0], whites, [], weighed=stands) == stands


def test_what_ties_with_an_effect_goes_without_those_that_go(rubbing):
    s, p = rubbing
    both, other = fitted(s, {COULOMB: [0.1], GAIN: [1.0]}), fitted(s, {DAMPING: [0.1], GAIN: [1.0]})
    rivals = [Rival(DAMPING, other, 0.5, "", tied=True), Rival(DAMPING, other, 9.0, "")]
    found = Decision(both, {COULOMB: rivals, GAIN: []}, Floor(), None, s)
    fewer = with_fewer(p, s, found, fitted(s, {COULOMB: [0.1]}))
    assert list(fewer.rivals) == [COULOMB]
    tied, worse = fewer.rivals[COULOMB]
    assert tied.tied and tied.fit.hypothesis.terms == (DAMPING,)
    # fitted again, and what does not tie is told as it was compared
    assert tied.fit.theta[0] != 0.1 and worse is rivals[1]
