"""All masses times a factor, and all drives weaker by it: the same motion where nothing given resists."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.whitening import Whitener
from mpge_jax.diagnosis.evidence.scored import Scored
from mpge_jax.diagnosis.selection.alternatives import _all_at_once
from mpge_jax.diagnosis.selection.search_state import Search
from tests.diagnosis.machines import really_sticks, record
from tests.diagnosis.searches import fitted, search_of

FACTOR, FRICTION = 1.5, np.array([0.2, 0.1])
ARM = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="{damping}"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass="1" contype="0" conaffinity="0"/>
<body name="fore" pos="0 0 -.3"><joint name="elbow" axis="0 1 0" damping="{damping}"/>
<geom type="capsule" fromto="0 0 0 0 0 -.25" size=".025" mass=".6" contype="0" conaffinity="0"/>
</body></body></worldbody>
<actuator><motor name="shoulder_motor" joint="shoulder"/><motor name="elbow_motor" joint="elbow"/></actuator>
</mujoco>"""


def _heavier(model: mujoco.MjModel) -> None:
    model.body_mass[:] *= FACTOR
    model.body_inertia[:] *= FACTOR
    model.dof_frictionloss[:] = FRICTION
    really_sticks(model)


def _searched(damping: float):
    xml = ARM.format(damping=damping)
    s, _ = search_of(xml, record(xml, [5.0, 1.5], change=_heavier, count=4))
    return s, {str(t): t for t in s.terms}


def _settled(s: Search, parts: dict[Term, float]) -> tuple[Scored, tuple[Whitener, Whitener]]:
    start = fitted(s, {t: [x] for t, x in parts.items()})
    found = fit(s.sim, [start], s.train, s.whiten_one(start, s.train), iterations=3)[0]
    whites = s.whiten(found)
    return s.score([found], whites)[0], whites


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_they_are_told_apart_by_what_the_given_model_resists_with(damping):
    s, terms = _searched(damping)
    friction = [terms["coulomb_friction@shoulder"], terms["coulomb_friction@elbow"]]
    mass = terms["mass_scale@world"]
    best, whites = _settled(s, {mass: FACTOR, **dict(zip(friction, FRICTION, strict=True))})
    (rival,) = _all_at_once(s, best, whites, mass, {})
    assert rival.tied == (damping == 0.0) and not rival.better
    assert rival.at == "shoulder_motor, elbow_motor"
    assert _all_at_once(s, best, whites, friction[0], {}) == []
    if rival.tied:
        its = {str(t): float(x[0]) for t, x in rival.fit.hypothesis.split(s.sim.ctx, rival.fit.theta).items()}
        assert its["actuator_gain@shoulder_motor"] == pytest.approx(1 / FACTOR, rel=0.03)
        assert its["coulomb_friction@elbow"] == pytest.approx(FRICTION[1] / FACTOR, rel=0.05)


def test_one_factor_takes_the_place_of_the_gains_of_all_drives():
    s, terms = _searched(0.0)
    friction = [terms["coulomb_friction@shoulder"], terms["coulomb_friction@elbow"]]
    gains = [terms["actuator_gain@shoulder_motor"], terms["actuator_gain@elbow_motor"]]
    weaker = dict.fromkeys(gains, 1 / FACTOR) | dict(zip(friction, FRICTION / FACTOR, strict=True))
    best, whites = _settled(s, weaker)
    (rival,) = [r for t in best.fit.hypothesis.named for r in _all_at_once(s, best, whites, t, {})]
    its = {str(t): float(x[0]) for t, x in rival.fit.hypothesis.split(s.sim.ctx, rival.fit.theta).items()}
    assert rival.better and set(its) == {"mass_scale@world", *map(str, friction)}
    assert its["mass_scale@world"] == pytest.approx(FACTOR, rel=0.03)
    assert its["coulomb_friction@elbow"] == pytest.approx(FRICTION[1], rel=0.05)
    # of one drive alone it is not so
    one, its_whites = _settled(s, {gains[0]: 1 / FACTOR})
    assert _all_at_once(s, one, its_whites, gains[0], {}) == []
