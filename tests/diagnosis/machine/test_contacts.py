"""Which geoms touch, and where effects of contacts are looked for."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.dataset.coarse_sampling import _scaled
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.base import REGISTRY, find_place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.evolution_strategy import polished
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit
from mpge_jax.diagnosis.evidence.null_distribution import floor
from mpge_jax.diagnosis.machine.contact_pairs import allowed_pairs, never_touches, touching_pairs
from mpge_jax.diagnosis.selection.remainder import leaves
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation.batch_simulator import Simulator
from tests.diagnosis.machines import BOX, record
from tests.diagnosis.searches import prepared_of, search_of

TWO = """<mujoco><option timestep="0.002"/><worldbody><geom name="floor" type="plane" size="5 5 1"/>
<body name="left" pos="-.5 0 .1"><joint name="a" type="slide" axis="1 0 0"/><joint name="u" type="slide" axis="0 0 1"/>
<geom name="left" type="sphere" size=".1" mass="1"/></body>
<body name="right" pos=".5 0 .1"><joint name="b" type="slide" axis="1 0 0"/><joint name="w" type="slide" axis="0 0 1"/>
<geom name="right" type="sphere" size=".1" mass="1"/></body></worldbody></mujoco>"""
FLOOR, LEFT, RIGHT = 0, 1, 2


@pytest.mark.parametrize(
    ("poses", "pairs"),
    [
        ([[0, 0, 0, 0]], ((FLOOR, LEFT), (FLOOR, RIGHT))),
        ([[0, 0.019, 0, 0.5]], ((FLOOR, LEFT),)),
        ([[0, 0.021, 0, 0.5]], ()),
        ([[0, 0.5, 0, 0.5], [0.39, 0.5, -0.4, 0.5]], ((LEFT, RIGHT),)),
        (np.zeros((0, 4)), ()),
    ],
)
def test_what_touches_in_the_recorded_poses(poses, pairs):
    model = mujoco.MjModel.from_xml_string(TWO)
    assert touching_pairs(model, np.array(poses), 1.0) == pairs
    assert allowed_pairs(model) == ((FLOOR, LEFT), (FLOOR, RIGHT), (LEFT, RIGHT))
    assert not model.geom_margin.any()


def test_bodies_of_several_geoms_come_near_too():
    two = '<geom name="left" type="sphere" size=".1" mass="1"/><geom name="hat" type="sphere" size=".05" pos="0 0 .2"/>'
    model = mujoco.MjModel.from_xml_string(
        TWO.replace('<geom name="left" type="sphere" size=".1" mass="1"/>', two)
    )
    assert touching_pairs(model, np.array([[0, 0.019, 0, 0.5]]), 1.0) == ((0, 1),)
    assert touching_pairs(model, np.array([[0, 0.021, 0, 0.5]]), 1.0) == ()


PAIR = '<contact><pair geom1="left" geom2="right"/></contact></mujoco>'
NO_MASKS = TWO.replace("<worldbody>", '<default><geom contype="0" conaffinity="0"/></default><worldbody>')


@pytest.mark.parametrize(
    ("xml", "never"),
    [(TWO, False), (NO_MASKS, True), (NO_MASKS.replace("</mujoco>", PAIR), False)],
    ids=["by masks", "without masks", "by a pair that is told"],
)
def test_windows_are_simulated_without_a_search_for_contacts_only_where_nothing_can_touch(xml, never):
    model = mujoco.MjModel.from_xml_string(xml)
    assert never_touches(model) == never
    sim = Simulator(model, prepared_of(xml, record(xml, [], seconds=0.5)).ctx)
    assert bool(sim.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT) == never
    assert not model.opt.disableflags


def _places(xml: str, missing: int | None = None) -> list[str]:
    recordings = record(xml, 1.0, seconds=0.5)
    for r in recordings:
        if missing is not None:
            r.qpos[:, missing] = np.nan
    p = prepared_of(xml, recordings)
    return [q.name for q in REGISTRY["contact_friction"].places(p.ctx)]


def test_a_geom_that_takes_part_in_all_contacts_is_the_world():
    assert _places(BOX) == ["world"]
    # two balls that never meet: all contacts are the floor's
    assert _places(TWO) == ["world", "left", "right"]
    # nothing comes near the floor
    assert (
        _places(TWO.replace('pos="-.5 0 .1"', 'pos="-.5 0 9"').replace('pos=".5 0 .1"', 'pos=".5 0 9"')) == []
    )
    # where heights were not measured, nobody knows what touched
    assert _places(TWO, missing=1) == ["world", "floor", "left", "right"]


LEG = """<mujoco><option timestep="0.004" integrator="RK4"/><worldbody><geom name="floor" type="plane" size="5 5 1"/>
<body pos="0 0 .35"><joint name="rail" type="slide" axis="0 0 1" damping="1"/>
<geom type="sphere" size=".05" mass="1" contype="0" conaffinity="0"/>
<body><joint name="leg" type="slide" axis="0 0 1" damping="2" armature=".05" range="-.1 .1"/>
<geom name="foot" type="sphere" size=".04" pos="0 0 -.3" mass=".2"/></body></body></worldbody>
<actuator><motor name="push" joint="leg"/></actuator></mujoco>"""


def _search(xml: str, **reality) -> tuple[Prepared, Search]:
    """The search in recordings of a leg that differs from `xml`, seen with an excellent encoder."""
    return search_of(xml, record(xml, 25.0, seconds=4.0, noise=1e-5, **reality))[::-1]


@pytest.mark.parametrize("integrator", ["RK4", "implicitfast"])
def test_impacts_in_finer_steps_are_no_physics_and_a_force_is(integrator):
    """A hopping leg with an encoder so good that what a timestep changes at an impact exceeds its noise by far."""
    xml = LEG.replace("RK4", integrator)

    def beyond(force=None) -> bool:
        p, s = _search(xml, force=force)
        return floor(p, NOTHING, p.config.decide_s).beyond(leaves(s, NOTHING).left)

    def drag(_model, data):
        data.qfrc_applied[1] -= 1.0 * data.qvel[1]

    assert not beyond()
    assert beyond(drag)


def test_a_load_is_found_through_impacts_without_slopes():
    """The hopping leg carries 0.3 kg more than modelled; the search starts from 0.36."""

    def loaded(model):
        model.body_mass[1] += 0.3

    p, s = _search(LEG, change=loaded)
    term = Term("payload_mass", find_place(p.ctx, REGISTRY["payload_mass"], "body_1"))
    theta = np.array([0.36, 0.0, 0.0, 0.0])
    start = Fitted(Hypothesis.of(term), theta, theta)
    white = s.whiten_one(start, s.train, temper=False)
    before = evaluate(s.sim, [start], s.train, white)[0]
    found = polished(s.sim, start, s.train, white, 0)
    assert found.loss < 0.8 * before.loss
    error, deviation = abs(found.theta[0] - 0.3), np.sqrt(found.cov[0, 0])
    assert error < 0.02 and error < 2.0 * deviation < 0.1
    # along a rail nothing tells where on the trunk the load is
    np.testing.assert_array_equal(found.theta[1:], theta[1:])
    again = polished(s.sim, start, s.train, white, 0)
    np.testing.assert_array_equal(again.theta, found.theta)


@pytest.mark.parametrize("start", [1.0, 3.3, 7.7])
def test_a_fit_among_impacts_follows_slopes_over_longer_differences(start, monkeypatch):
    """A residual that falls evenly towards 30 scales, under ripples that make it as steep as fifty times that, either
    way, over the usual difference."""
    p = prepared_of(BOX, record(BOX, 1.0))
    assert p.ctx.contacts
    w = p.windows("train", p.config.decide_s, 10)
    term = Term("viscous_damping", find_place(p.ctx, REGISTRY["viscous_damping"], "x"))
    scale = term.params(p.ctx)[0].scale

    def rippled(runs, w):
        u = np.array([run.theta[0] for run in runs]) / scale
        miss = u - 30.0 + 0.5 * np.sin(100.0 * u)
        return np.broadcast_to(miss[:, None, None, None], (len(runs), *w.seen.shape, 4)).copy()

    monkeypatch.setattr(p.sim, "residuals", rippled)
    theta = np.array([start * scale])
    f = fit(p.sim, [Fitted(Hypothesis.of(term), theta, theta)], w, _scaled(w, np.ones(4)))[0]
    assert abs(f.theta[0] / scale - 30.0) < 1.0
