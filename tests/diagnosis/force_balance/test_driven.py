"""Driven machines of which the forces of their drives say what is missing."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.force_balance import driven
from mpge_jax.diagnosis.force_balance.driven import forces_are_known, missing_by_forces
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from tests.diagnosis.machines import ARM, BOX, FOUR_BAR, record
from tests.diagnosis.searches import search_of

RUBS, DAMPED, ROTOR = (
    Term("coulomb_friction", Place("joint", "elbow", 1)),
    Term("viscous_damping", Place("joint", "shoulder", 0)),
    Term("armature", Place("joint", "shoulder", 0)),
)


def _lacking(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[1] = 0.15
    model.dof_damping[0] += 0.2
    model.dof_armature[0] += 0.05


@pytest.fixture(scope="module")
def arm():
    """An arm of a motor and a servo that lacks three things."""
    return search_of(ARM, record(ARM, [0.5, 0.3], change=_lacking, count=5, seconds=3.0, rate=200))


def test_commands_of_a_motor_and_a_servo_tell_all_that_is_missing_at_once(arm):
    _, p = arm
    before = list(p.warnings)
    f = missing_by_forces(p)
    parts = f.hypothesis.split(p.ctx, f.theta)
    assert {RUBS, DAMPED, ROTOR} <= set(parts) and len(parts) <= 5
    assert parts[RUBS] == pytest.approx(0.15, rel=0.1)
    assert parts[DAMPED] == pytest.approx(0.2, rel=0.1) and parts[ROTOR] == pytest.approx(0.05, rel=0.1)
    assert p.warnings == before


def test_recordings_that_choose_or_test_are_not_asked(arm, monkeypatch):
    _, p = arm
    asked = []

    def decided(told, _say):
        asked.extend(s.recording.name for s in told.looked_at)
        return SimpleNamespace(fit=NOTHING)

    monkeypatch.setattr(driven, "decide", decided)
    assert missing_by_forces(p) is None
    assert asked == [s.recording.name for s in p.train] and len(asked) < len(p.sources)


def test_logs_of_single_transitions_and_with_holes_are_not_asked(arm):
    _, p = arm

    def with_hole(s: Source) -> Source:
        qpos = s.recording.qpos.copy()
        qpos[40, 0] = np.nan
        return replace(s, recording=replace(s.recording, qpos=qpos))

    def first_rows(s: Source) -> Source:
        r = s.recording
        cut = {k: getattr(r, k)[:2] for k in ("time", "qpos", "ctrl")}
        return replace(s, recording=replace(r, **cut))

    assert forces_are_known(p)
    assert not forces_are_known(p.mapped(with_hole)) and not forces_are_known(p.mapped(first_rows))
    whole, *others = p.train
    some = replace(p, train=(whole, *map(with_hole, others)))
    assert forces_are_known(some) and missing_by_forces(some) is not None


LAGS = ARM.replace(
    '<motor name="shoulder_motor" joint="shoulder"/>',
    '<general name="shoulder_motor" joint="shoulder" dyntype="filter" dynprm="0.05" biastype="none"/>',
)


@pytest.mark.parametrize("xml", [BOX, FOUR_BAR, LAGS], ids=["contacts", "loop", "drive with a state"])
def test_nobody_knows_the_forces_in_contacts_and_loops_and_of_drives_with_a_state(xml):
    s, p = search_of(xml, record(xml, 0.5, count=3, seconds=1.0))
    assert not forces_are_known(p) and s.by_forces is None


def test_a_search_asks_its_own_recordings(arm):
    s, p = arm
    f = s.by_forces()
    assert f.hypothesis == missing_by_forces(p).hypothesis
