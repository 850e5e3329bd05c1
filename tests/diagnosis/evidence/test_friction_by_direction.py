"""Dry friction beside a constant force of the drive, and dry friction that differs by direction: the same motion."""

from __future__ import annotations

import mujoco
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.evidence.scored import Rival
from mpge_jax.diagnosis.selection.alternatives import _all_at_once
from mpge_jax.diagnosis.selection.search_state import Search
from tests.diagnosis.machines import PENDULUM, really_sticks, record
from tests.diagnosis.searches import COULOMB, DAMPING, HINGE, MOTOR, fitted, search_of

BIAS, BY_DIRECTION = Term("actuator_bias", MOTOR), Term("asymmetric_friction", HINGE)
GEAR, DRY, PUSH, VISCOUS = 2.0, 0.06, 0.03, 0.02
GEARED = PENDULUM.replace('joint="hinge"', f'joint="hinge" gear="{GEAR:g}"')
FORWARDS, BACKWARDS = DRY - PUSH, DRY + PUSH


def searched(damping: float = 0.0, slower_back: float = 0.0, dry: float = DRY) -> Search:
    """Dry friction and a push, with more damping; backwards even more."""

    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] = dry
        model.dof_damping[0] += damping
        really_sticks(model, 0)

    def force(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[0] += PUSH - slower_back * min(float(data.qvel[0]), 0.0)

    s, _ = search_of(GEARED, record(GEARED, 0.4, change=change, force=force, seconds=3.0))
    return s


def rivals_of(s: Search, parts: dict[Term, list[float]]) -> dict[str, list[Rival]]:
    start = fitted(s, parts)
    found = fit(s.sim, [start], s.train, s.whiten_one(start, s.train), iterations=6)[0]
    whites = s.whiten(found)
    (best,) = s.score([found], whites)
    return {t.id: _all_at_once(s, best, whites, t, {}) for t in found.hypothesis.named}


def told(s: Search, rival: Rival) -> dict[str, list[float]]:
    return {t.id: x.tolist() for t, x in rival.fit.hypothesis.split(s.sim.ctx, rival.fit.theta).items()}


@pytest.mark.parametrize("damping", [0.0, VISCOUS])
def test_they_tie_whichever_was_found(damping):
    s = searched(damping)
    plain = {COULOMB: [DRY], BIAS: [PUSH / GEAR]} | ({DAMPING: [damping]} if damping else {})
    for rivals in rivals_of(s, plain).values():
        (rival,) = rivals
        assert rival.tied and not rival.better
        assert told(s, rival) == {
            BY_DIRECTION.id: pytest.approx([FORWARDS, BACKWARDS, damping, damping], abs=2e-3)
        }
    ((rival,),) = rivals_of(s, {BY_DIRECTION: [FORWARDS, BACKWARDS, damping, damping]}).values()
    assert rival.tied and not rival.better and {rival.term, *rival.beside} == set(plain)
    assert told(s, rival) == {t.id: pytest.approx(x, abs=2e-3) for t, x in plain.items()}


def test_damping_that_differs_by_direction_tells_them_apart():
    s = searched(VISCOUS, slower_back=0.05)
    ((rival,),) = rivals_of(s, {BY_DIRECTION: [FORWARDS, BACKWARDS, VISCOUS, VISCOUS + 0.05]}).values()
    assert not rival.tied and not rival.better


def test_a_push_that_moves_the_joint_by_itself_is_no_friction():
    weak = 0.5 * PUSH
    s = searched(dry=weak)
    assert not any(rivals_of(s, {COULOMB: [weak], BIAS: [PUSH / GEAR]}).values())
