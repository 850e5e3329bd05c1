"""Dry friction that gives way before it slides is told from friction that does not, and from a flexible drive."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.selection import closer_forms
from mpge_jax.diagnosis.selection.backward_elimination import final_fit, prune
from mpge_jax.diagnosis.selection.closer_forms import closer, with_plain
from mpge_jax.diagnosis.selection.forward_selection import search
from tests.diagnosis.machines import PENDULUM, really_sticks, record
from tests.diagnosis.searches import COULOMB, HINGE, fitted, reported, search_of

SLIDES, STIFFNESS, DAMPED = 0.15, 30.0, 0.26
INERTIA = 0.0195
"""kg m^2 of the pendulum about its hinge."""


def _bristles(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """LuGre, integrated by itself: 0.15 N m, 30 N m/rad, 0.26 of critical damping."""
    dt, v = model.opt.timestep, float(data.qvel[0])
    if data.time == 0.0:
        _bristles.bent = 0.0
    rate = v - STIFFNESS * abs(v) * _bristles.bent / SLIDES
    _bristles.bent += dt * rate
    data.qfrc_applied[0] -= STIFFNESS * _bristles.bent + 2 * DAMPED * np.sqrt(STIFFNESS * INERTIA) * rate


def _rigid(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[0], model.dof_damping[0] = SLIDES, 0.05
    really_sticks(model, 0)


def _search(change: Callable | None = None, force: Callable | None = None):
    return search_of(PENDULUM, record(PENDULUM, 0.8, change=change, force=force, seconds=3.0))[0]


@pytest.fixture(scope="module")
def elastic():
    return _search(force=_bristles)


def test_it_is_found_named_as_its_law_and_leaves_nothing_for_others(elastic):
    found, _ = final_fit(elastic, search(elastic)[0])
    assert str(found.hypothesis) == "coulomb_friction@hinge" and found.hypothesis != COULOMB
    (term,) = found.hypothesis.terms
    values = term.effect.report(elastic.sim.ctx, term.place, found.theta)
    assert values["torque"] == pytest.approx(SLIDES, rel=0.02)
    assert values["stiffness"] == pytest.approx(STIFFNESS, rel=0.1)
    assert values["damping_ratio"] == pytest.approx(DAMPED, abs=0.05)
    # it is not taken back as what is not needed
    assert prune(elastic, found).hypothesis == found.hypothesis
    rigid = with_plain(elastic.sim.ctx, found, [term])
    assert rigid.hypothesis.terms == (COULOMB,) and rigid.theta.tolist() == found.theta[:1].tolist()


def test_friction_that_does_not_give_way_stays_rigid_though_something_else_is_left():
    s = _search(change=_rigid)
    current = fitted(s, {COULOMB: [SLIDES]})
    assert closer(s, current) is current


def test_friction_that_gives_way_too_little_to_matter_stays_rigid(monkeypatch):
    """Stiff bristles beside a pull of another size that is known: they show, and move nothing."""
    s = _search(force=_bristles)
    current = fitted(s, {COULOMB: [SLIDES]})
    monkeypatch.setattr(closer_forms, "moves", lambda _s, new, old: new is old)
    assert closer(s, current) is current
    # what a first look lets through, evidence decides: a law of which all is fitted may take from one of its parts
    looks = iter([False, True])
    monkeypatch.setattr(closer_forms, "moves", lambda *_: next(looks, False))
    assert [t.id for t in closer(s, current).hypothesis.terms] == ["coulomb_friction:elastic"]


@pytest.mark.parametrize(("factor", "fits"), [(3.0, 1), (1.0, 3)])
def test_a_form_that_all_windows_speak_against_is_fitted_no_further(elastic, monkeypatch, factor, fits):
    """What a sample says may be far off elsewhere."""
    own, asked = closer_forms.fit, []

    def fit(sim, starts, w, white, **options):
        asked.append(w.count)
        return [replace(f, theta=factor * f.theta) for f in own(sim, starts, w, white, **options)]

    monkeypatch.setattr(closer_forms, "fit", fit)
    monkeypatch.setattr(closer_forms, "moves", lambda *_: True)
    current = fitted(elastic, {COULOMB: [SLIDES]})
    better = closer_forms._with_better(elastic, current, closer_forms._forms(elastic, current, 1))
    assert (better is current) == (fits == 1)
    assert len(asked) == fits and asked[0] < elastic.train.count


FALLING = "load_dependent_friction:falling"


def _gear(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Dry friction of a fifth of the motor's torque, twice that at rest, falling by 0.5 rad/s; 0.03 N m s/rad."""
    load, v = abs(float(data.ctrl[0])), float(data.qvel[0])
    model.dof_frictionloss[0] = 0.2 * load * (1.0 + np.exp(-((v / 0.5) ** 2)))
    data.qfrc_applied[0] -= 0.03 * v


@pytest.fixture(scope="module")
def geared():
    return _search(change=lambda m: really_sticks(m, 0), force=_gear)


@pytest.mark.parametrize("start", [("load_dependent_friction", [0.0, 0.3]), (FALLING, [0.0, 0.25, 0.3, 0.1])])
def test_friction_under_load_that_falls_from_rest_is_found_beside_damping(geared, start):
    """Also where it was found before, but without damping."""
    form, theta = start
    better = closer(geared, fitted(geared, {Term(form, HINGE): theta}))
    damping, falling = Term("viscous_damping", HINGE), Term(FALLING, HINGE)
    assert set(better.hypothesis.terms) == {falling, damping}
    parts = better.hypothesis.split(geared.sim.ctx, final_fit(geared, better)[0].theta)
    assert parts[damping] == pytest.approx([0.03], rel=0.05)
    assert parts[falling] == pytest.approx([0.0, 0.2, 1.0, 0.5], rel=0.1, abs=0.005)


def test_friction_under_load_that_does_not_fall_keeps_its_plain_form():
    def plain(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        model.dof_frictionloss[0] = 0.2 * abs(float(data.ctrl[0]))
        data.qfrc_applied[0] -= 0.3 * np.sin(3.0 * float(data.qpos[0]))

    s = _search(change=lambda m: really_sticks(m, 0), force=plain)
    current = fitted(s, {Term("load_dependent_friction", HINGE): [0.0, 0.2]})
    assert closer(s, current) is current


SPRING, COGS = Term("joint_stiffness", HINGE), Term("cogging_torque", HINGE)
FLOOR = '<worldbody><geom type="plane" size="1 1 1" pos="0 0 -.321"/>'
OVER_A_FLOOR = PENDULUM.replace("<worldbody>", FLOOR).replace(' contype="0" conaffinity="0"', "")


def _hardens(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qfrc_applied[0] -= 0.5 * float(data.qpos[0]) ** 3


@pytest.fixture(scope="module")
def hardening():
    """In a machine that may strike the ground, as legs do."""
    return search_of(OVER_A_FLOOR, record(OVER_A_FLOOR, 0.8, force=_hardens, seconds=3.0))[0]


def test_a_spring_may_harden_where_things_may_strike_each_other(hardening):
    s = hardening
    assert s.sim.rugged(Hypothesis())
    found = closer(s, final_fit(s, fitted(s, {SPRING: [0.2, 0.0]}))[0])
    assert [t.id for t in found.hypothesis.terms] == ["joint_stiffness:hardening"]
    assert reported(s, found)["cubic"] == pytest.approx(0.5, rel=0.1)


def test_one_closer_form_takes_the_place_of_two_effects_that_imitate_it(hardening):
    """A soft spring and the beginning of a wave: their sum bends as the cube does."""
    s = hardening
    two = final_fit(s, fitted(s, {SPRING: [0.4, 0.0], COGS: [-0.3, 0.0, 1.5]}))[0]
    found = closer(s, two)
    assert [t.id for t in found.hypothesis.terms] == ["joint_stiffness:hardening"]
    # but not of two that act
    both = search_of(PENDULUM, record(PENDULUM, 0.8, change=_stiff, force=_wave, seconds=3.0))[0]
    two = final_fit(both, fitted(both, {SPRING: [0.5, 0.0], COGS: [0.2, 0.0, 6.0]}))[0]
    assert set(closer(both, two).hypothesis.terms) == {SPRING, COGS}


def _stiff(model: mujoco.MjModel) -> None:
    model.jnt_stiffness[0] = 0.5


def _wave(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qfrc_applied[0] += 0.2 * np.sin(6.0 * float(data.qpos[0]))
