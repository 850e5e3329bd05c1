"""Masses and inertias near the given ones: corrected, told, and not taken for missing physics."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.inertia.given import given_inertias
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.evidence.scored import Scored, evidence, held_out_evidence, hopeful
from mpge_jax.diagnosis.selection import forward_selection, given_masses
from mpge_jax.diagnosis.selection.given_masses import as_given
from tests.diagnosis.machines import ARM, really_sticks, record
from tests.diagnosis.searches import ARMATURE, COULOMB, GAIN, STRIBECK, fitted, search_of

LIKE_A_MASS = Config(
    effects=(
        "coulomb_friction",
        "viscous_damping",
        "armature",
        "payload_mass",
        "mass_scale",
        "com_offset",
        "actuator_gain",
    ),
    jobs=1,
    quiet=True,
)
"""Effects that pass for a mass or stand beside one; the rest of the vocabulary only takes time."""
TRUE = {"upper": (1.05, 0.96), "fore": (0.95, 1.04)}


def _off(model: mujoco.MjModel) -> None:
    for name, (mass, inertia) in TRUE.items():
        model.body_mass[model.body(name).id] *= mass
        model.body_inertia[model.body(name).id] *= inertia


def _rubbing(model: mujoco.MjModel) -> None:
    _off(model)
    model.dof_frictionloss[0] = 0.15
    really_sticks(model, 0)


def _held_back(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """0.1 N m more friction forwards, and as much less backwards."""
    data.qfrc_applied[0] = -0.1


def _scored(s, loss: float, *terms) -> Scored:
    return Scored(
        fitted(s, {t: np.ones(len(t.params(s.sim.ctx))) for t in terms}),
        np.full(4, loss),
        np.full(4, loss),
        1,
        1,
    )


@pytest.mark.parametrize(("factor", "news"), [(1.02, False), (1.09, True)])
def test_a_factor_of_all_masses_is_news_where_masses_are_not_off_by_as_much(factor, news):
    def change(model: mujoco.MjModel) -> None:
        model.body_mass[:] *= factor
        model.body_inertia[:] *= factor

    s, _ = search_of(ARM, record(ARM, [4.0, 0.8], change=change))
    scale = next(t for t in s.terms if t.id == "mass_scale")
    f = fitted(s, {scale: [factor]})
    told = as_given(s, f)
    assert (told is f) == news
    if not news:
        (given,) = told.hypothesis.terms
        assert not told.hypothesis.named
        masses = given.effect.report(s.sim.ctx, given.place, told.theta)["mass"]
        assert masses == pytest.approx(factor, abs=0.01)
        # it was fitted under the prior that has them as given, and has them already
        assert (told.centre == 1.0).all() and as_given(s, told) is told


def test_a_factor_of_all_masses_that_theirs_can_be_is_asked_however_sure_slopes_are_of_it(monkeypatch):
    """Finite differences of the one and of the others are not quite alike, so that it seems to be known apart."""

    def change(model: mujoco.MjModel) -> None:
        model.body_mass[:] *= 0.98
        model.body_inertia[:] *= 0.98

    s, _ = search_of(ARM, record(ARM, [4.0, 0.8], change=change))
    monkeypatch.setattr(given_masses, "strength", lambda _s, f: dict.fromkeys(f.hypothesis.terms, np.inf))
    scale = next(t for t in s.terms if t.id == "mass_scale")
    assert not as_given(s, fitted(s, {scale: [0.98]})).hypothesis.named
    asked: list[Term] = []
    monkeypatch.setattr(given_masses, "_instead", lambda _s, f, t, _given: asked.append(t) or f)
    as_given(s, fitted(s, {scale: [0.88]}))
    assert not asked


@pytest.mark.parametrize("form", [[], [0.02]], ids=["a point", "extended"])
def test_a_payload_gives_way_to_a_given_mass_that_is_a_little_off_in_either_form(form):
    def change(model: mujoco.MjModel) -> None:
        model.body_mass[2] *= 1.02

    s, _ = search_of(ARM, record(ARM, [4.0, 0.8], change=change))
    payload = next(t for t in s.terms if t.id == "payload_mass" and t.place.name == "fore")
    term = Term("payload_mass:extended", payload.place) if form else payload
    mass, centre = s.sim.model.body_mass[2], s.sim.model.body_ipos[2]
    told = as_given(s, fitted(s, {term: [0.02 * mass, *centre, *form]}))
    assert told.hypothesis.terms and not told.hypothesis.named


@pytest.mark.parametrize("news", [False, True])
def test_friction_differs_by_direction_where_masses_that_are_a_little_off_do_not_say_so(news):
    s, _ = search_of(ARM, record(ARM, [2.0, 1.0], change=_rubbing, force=_held_back if news else None))
    law = next(t for t in s.terms if str(t) == "asymmetric_friction@shoulder")
    f = fitted(s, {law: [0.17, 0.13, 0.01, 0.01]})
    (f,) = fit(s.sim, [f], s.train, s.whiten(f)[0])
    told = as_given(s, f)
    assert (told is f) == news
    if not news:
        assert {"coulomb_friction@shoulder", "viscous_damping@shoulder"} == set(
            map(str, told.hypothesis.named)
        )


def test_masses_do_not_stand_for_physics_that_explains_more(null, monkeypatch):
    s, _ = null
    base, given = _scored(s, 3.0), _scored(s, 2.0, given_inertias(0.03))
    monkeypatch.setattr(forward_selection, "accept", lambda _s, new, _old: new is given)
    better, worse = _scored(s, 1.0, COULOMB), _scored(s, 2.5, COULOMB)
    assert forward_selection._chosen(s, [better, given], base) is None
    assert forward_selection._chosen(s, [given, worse], base) is given


def test_given_masses_cost_what_they_are_unlikely(null):
    """Half the square of their deviations in all, once, however many windows there are; of other effects nothing."""
    s, _ = null
    given = given_inertias(0.03)
    factors = np.ones(len(given.params(s.sim.ctx)))
    factors[:2] = 1.03, 1.0 - 2 * 0.03
    f = fitted(s, {given: factors, COULOMB: [0.1]})
    assert f.unlikely(s.sim.ctx) == pytest.approx(0.5 * (1 + 4))
    now, free = s.score([NOTHING, f], s.whiten(NOTHING))
    assert now.unlikely == 0.0 and free.unlikely == pytest.approx(2.5)
    gain = evidence(replace(free, unlikely=0.0), now)
    assert evidence(free, now) == pytest.approx(gain - 2.5) and evidence(now, free) == pytest.approx(
        2.5 - gain
    )
    assert held_out_evidence(free, replace(now, unlikely=2.5)) == held_out_evidence(
        replace(free, unlikely=0.0), now
    )


def test_masses_take_no_candidates_place(null):
    s, _ = null
    terms = [COULOMB, given_inertias(0.03), GAIN, STRIBECK, ARMATURE]
    fits = [
        replace(fitted(s, {t: np.ones(len(t.params(s.sim.ctx)))}), loss=2.9 + 0.01 * k)
        for k, t in enumerate(terms)
    ]
    fits[0] = replace(fits[0], loss=1.0)
    kept = [f.hypothesis.terms[0] for f in hopeful(fits, before=3.0)]
    # armature is the third family beside friction, whose laws are one
    assert kept == [COULOMB, given_inertias(0.03), GAIN, ARMATURE]


@pytest.fixture(scope="module")
def off():
    return record(ARM, [2.0, 1.0], change=_off)


def test_inexact_masses_alone_are_no_missing_physics(off, tmp_path):
    d = diagnose(mujoco.MjSpec.from_string(ARM), off, LIKE_A_MASS)
    assert d.verdict == "none" and not d.terms
    d.write(tmp_path)
    table = json.loads((tmp_path / "diagnosis.json").read_text())
    assert table["effects"] == [] and [b["at"] for b in table["given_inertias"]] == list(TRUE)
    for body, (mass, _) in zip(table["given_inertias"], TRUE.values(), strict=True):
        assert abs(body["mass"]["value"] - mass) < 0.01 and body["mass"]["high"] - body["mass"]["low"] < 0.1
    assert "<h2>Masses and inertias as given</h2>" in (tmp_path / "report.html").read_text()
    assert "not exact" in table["explanation"] and "Nothing is missing" not in table["explanation"]
    held = table["fit"]["held_out"]
    assert held["after"] < 0.2 * held["before"]
    corrected = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))
    given = mujoco.MjModel.from_xml_string(ARM)
    factors = corrected.body_mass[1:] / given.body_mass[1:]
    np.testing.assert_allclose(factors, [b["mass"]["value"] for b in table["given_inertias"]], rtol=2e-6)


def test_physics_is_named_beside_inexact_masses():
    recordings = record(ARM, [2.0, 1.0], change=_rubbing)
    d = diagnose(mujoco.MjSpec.from_string(ARM), recordings, LIKE_A_MASS)
    assert d.verdict == "effects" and [str(t) for t in d.terms] == ["coulomb_friction@shoulder"]
    assert d.given_inertias is not None
    (effect,) = d.to_json()["effects"]
    (found,) = effect["parameters"].values()
    assert abs(found["value"] - 0.15) < 0.006


def test_masses_that_are_exact_are_left_alone(off, left_alone):
    # one effect is enough to stand for them
    exact = replace(LIKE_A_MASS, masses_within=0.0, effects=("payload_mass", "mass_scale"), max_effects=1)
    d = diagnose(mujoco.MjSpec.from_string(ARM), off, exact)
    assert d.given_inertias is None and d.verdict != "none"
    with pytest.raises(ValueError, match="masses_within must lie between 0 and"):
        Config(masses_within=0.4)
    with pytest.raises(ValueError, match="effects must be a tuple of names or None, got 'payload_mass'"):
        Config(effects="payload_mass")


@pytest.mark.parametrize("gain", [1.0, 0.8])
def test_a_drive_is_weak_where_masses_that_are_a_little_off_do_not_make_it_so(gain):
    """No list says which effects masses pass for: with heavier arms a servo seems weak."""

    def change(model: mujoco.MjModel) -> None:
        model.body_mass[:] *= 1.03
        model.body_inertia[:] *= 1.03
        model.actuator_gainprm[0] *= gain

    s, _ = search_of(ARM, record(ARM, [4.0, 0.8], change=change))
    drive = next(t for t in s.terms if str(t) == "actuator_gain@shoulder_motor")
    start = fitted(s, {drive: [gain]})
    (f,) = fit(s.sim, [start], s.train, s.whiten(start)[0])
    told = as_given(s, f)
    assert set(told.hypothesis.named) == (set() if gain == 1.0 else {drive})
    if gain == 1.0:
        assert f.theta[0] < 0.99
