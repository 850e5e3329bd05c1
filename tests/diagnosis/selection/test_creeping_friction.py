"""Dry friction that creeps as MuJoCo's own does, and dry friction that sticks."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.friction.dry import CREEPING
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.selection.closer_forms import as_dry_friction_sets_in, closer
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
    found = as_dry_friction_sets_in(s, plain)
    if sticks:
        assert found is plain
        creeps = fitted(
            s, {Term(CREEPING, t.place): x for t, x in plain.hypothesis.split(s.sim.ctx, plain.theta).items()}
        )
        assert as_dry_friction_sets_in(s, creeps).hypothesis == plain.hypothesis
        return
    assert {t.id for t in found.hypothesis.terms} == {"coulomb_friction:creeping"}
    np.testing.assert_allclose(found.theta, TORQUES, rtol=0.005)
    # what was found stays so, and is asked for before forms that have more to fit
    assert as_dry_friction_sets_in(s, found) is found
    assert closer(s, plain).hypothesis == found.hypothesis


def test_the_corrected_model_has_mujocos_own_friction_loss():
    corrected, _ = exported(ARM, {"coulomb_friction:creeping": ("shoulder", [0.2])})
    plain = mujoco.MjModel.from_xml_string(ARM)
    assert corrected.dof_frictionloss[0] == pytest.approx(0.2)
    np.testing.assert_array_equal(corrected.dof_solref, plain.dof_solref)
    np.testing.assert_array_equal(corrected.dof_solimp, plain.dof_solimp)
