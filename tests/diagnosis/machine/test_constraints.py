"""What constraints make of a machine's forces: loops of bodies, and contacts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.machine.constraints import coupled, free_of_constraints
from mpge_jax.diagnosis.simulation.scales import inverse_samples
from mpge_jax.diagnosis.verdict.elsewhere import elsewhere
from tests.diagnosis.machines import BOX, FINE_ARM, FOUR_BAR, record
from tests.diagnosis.searches import prepared_of

TORQUE = 0.4


def _pushed(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qfrc_applied[0] = TORQUE


@pytest.fixture(scope="module")
def four_bar():
    """A four-bar linkage beside a pendulum that turns alone; something pushes the crank."""
    return prepared_of(FOUR_BAR, record(FOUR_BAR, 0.6, force=_pushed, count=2))


def test_joints_of_a_loop_are_coupled_and_others_are_not(four_bar):
    assert coupled(four_bar.model).tolist() == [True, True, True, False]
    assert not coupled(mujoco.MjModel.from_xml_string(FINE_ARM)).any()


def test_how_far_noise_opens_a_loop_is_no_missing_force(four_bar):
    samples, needed, *_ = inverse_samples(four_bar.model, four_bar.sources)
    # one way to move is left of three joints: what pushes the crank is told by what it does there
    assert (samples.share[:, :3].sum(1) == pytest.approx(1.0, abs=1e-6)) and (
        samples.share[:, 3] == 1.0
    ).all()
    crank = samples.residual[:, 0] / samples.share[:, 0]
    assert np.median(crank) == pytest.approx(TORQUE, rel=0.1)
    assert np.abs(needed).max() < 20.0


def test_what_acts_elsewhere_is_not_asked_while_a_joint_of_a_loop_is_forced(four_bar):
    assert elsewhere(four_bar, None, None, ["crank", "crank_motor", "rod"], lambda _text: None) is None


def test_what_contacts_could_be_is_no_missing_force():
    model = mujoco.MjModel.from_xml_string(BOX)
    data = mujoco.MjData(model)
    data.qpos[1] = 0.5
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(free_of_constraints(model, data), np.eye(2))
    data.qpos[1] = -1e-4
    mujoco.mj_forward(model, data)
    # the floor can push the box up and along
    np.testing.assert_allclose(free_of_constraints(model, data), 0.0, atol=1e-9)
    leg = FINE_ARM.replace(
        "<worldbody>", '<worldbody><geom name="floor" type="plane" size="5 5 1" pos="0 0 -.5"/>'
    )
    leg = leg.replace('fromto="0 0 0 0 0 -.25" size=".025" mass=".6" contype="0" conaffinity="0"',
                      'fromto="0 0 0 0 0 -.25" size=".025" mass=".6"')  # fmt: skip
    for jacobian in ("dense", "sparse"):
        model = mujoco.MjModel.from_xml_string(
            leg.replace('integrator="implicitfast"', f'integrator="implicitfast" jacobian="{jacobian}"')
        )
        data = mujoco.MjData(model)
        data.qpos[:] = [0.5, -0.6]
        mujoco.mj_forward(model, data)
        assert data.ncon
        free = free_of_constraints(model, data)
        jac = np.zeros((3, 2))
        mujoco.mj_jac(model, data, jac, None, data.contact[0].pos, 2)
        toward = jac.T @ np.array([0.0, 0.0, 1.0])
        np.testing.assert_allclose(free @ toward, 0.0, atol=1e-9)
        np.testing.assert_allclose(free @ free, free, atol=1e-9)
