"""Forms that effects have alike in the whole machine: how dry friction sets in, on which side of limits effects act."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.friction.dry import CREEPING
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.selection.closer_forms import closer, in_common_forms
from tests.diagnosis.machines import ARM, really_sticks, record
from tests.diagnosis.searches import exported, fitted, search_of

TORQUES = np.array([0.2, 0.1])


def _rubbing(sticks: bool):
    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[:] = TORQUES
        if sticks:
            really_sticks(model)

    return record(ARM, [1.0, 0.6], change=change, count=5, seconds=3.0, noise=3e-5)


@pytest.mark.parametrize("sticks", [True, False])
def test_windows_tell_how_dry_friction_sets_in(sticks):
    s, _ = search_of(ARM, _rubbing(sticks))
    terms = {str(t): t for t in s.terms}
    start = fitted(s, {terms["coulomb_friction@shoulder"]: [0.2], terms["coulomb_friction@elbow"]: [0.1]})
    plain = fit(s.sim, [start], s.train, s.whiten_one(start, s.train), iterations=4)[0]
    found = in_common_forms(s, plain)
    if sticks:
        assert found is plain
        creeps = fitted(
            s, {Term(CREEPING, t.place): x for t, x in plain.hypothesis.split(s.sim.ctx, plain.theta).items()}
        )
        assert in_common_forms(s, creeps).hypothesis == plain.hypothesis
        return
    assert {t.id for t in found.hypothesis.terms} == {"coulomb_friction:creeping"}
    np.testing.assert_allclose(found.theta, TORQUES, rtol=0.005)
    # what was found stays so, and is asked for before forms that have more to fit
    assert in_common_forms(s, found) is found
    assert closer(s, plain).hypothesis == found.hypothesis


def test_the_corrected_model_has_mujocos_own_friction_loss():
    corrected, _ = exported(ARM, {"coulomb_friction:creeping": ("shoulder", [0.2])})
    plain = mujoco.MjModel.from_xml_string(ARM)
    assert corrected.dof_frictionloss[0] == pytest.approx(0.2)
    np.testing.assert_array_equal(corrected.dof_solref, plain.dof_solref)
    np.testing.assert_array_equal(corrected.dof_solimp, plain.dof_solimp)


LIMITED = ARM.replace('kp="8" kv="0.4"', 'kp="8" kv="0.4" forcerange="-1.5 1.5"')


def _weak(before: bool):
    """A servo with 0.7 of its force that brakes by 0.3 more, before its limits or with them."""

    def change(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[1, 0] *= 0.7
        model.actuator_biasprm[1] *= 0.7
        if before:
            model.actuator_biasprm[1, 2] -= 0.3
        else:
            model.actuator_forcerange[1] *= 0.7
            model.dof_damping[1] += 0.3

    return change


@pytest.mark.parametrize("before", [True, False])
def test_windows_tell_on_which_side_of_a_drives_limits_effects_act(before):
    s, _ = search_of(LIMITED, record(LIMITED, [0.5, 1.0], change=_weak(before), noise=3e-5))
    terms = {str(t): t for t in s.terms if not t.id.endswith((":limited", ":servo", ":explicit"))}
    start = fitted(s, {terms["actuator_gain@elbow_servo"]: [0.8], terms["viscous_damping@elbow"]: [0.2]})
    (plain,) = fit(s.sim, [start], s.train, s.whiten_one(start, s.train))
    found = in_common_forms(s, plain)
    names = (
        {"actuator_gain:limited", "viscous_damping:servo"} if before else {"actuator_gain", "viscous_damping"}
    )
    assert {t.id for t in found.hypothesis.terms} == names
    (found,) = fit(s.sim, [found], s.train, s.whiten_one(found, s.train))
    parts = {t.name: x for t, x in found.hypothesis.split(s.sim.ctx, found.theta).items()}
    assert parts["actuator_gain"] == pytest.approx(0.7, abs=0.01)
    assert parts["viscous_damping"] == pytest.approx(0.3, abs=0.01)
    # neither goes back
    assert in_common_forms(s, found).hypothesis == found.hypothesis
