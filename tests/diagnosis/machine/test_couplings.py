"""Joints that were not measured, told by equalities with others."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Recording
from mpge_jax.diagnosis.dataset.coarse_sampling import states_as_measured
from mpge_jax.diagnosis.machine.couplings import led
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from tests.diagnosis.searches import prepared_of

LIFT = """<mujoco><option timestep="0.002" gravity="0 0 -9.81"/><worldbody>
<body><joint name="sheave" axis="0 1 0" damping="40"/><geom size=".2" mass="50"/></body>
<body pos="1 0 0"><joint name="cabin" type="slide" axis="0 0 1"/><geom size=".2" mass="80"/></body>
<body pos="2 0 0"><joint name="weight" type="slide" axis="0 0 1"/><geom size=".2" mass="90"/></body>
</worldbody><equality><joint joint1="cabin" joint2="sheave" polycoef="0 0.3 0 0 0"/>
<joint joint1="weight" joint2="cabin" polycoef="0.02 -1 0.1 0 0"/></equality>
<actuator><motor name="machine" joint="sheave"/></actuator></mujoco>"""
MODEL = mujoco.MjModel.from_xml_string(LIFT)


def test_a_joint_follows_what_is_known_by_then():
    # the cabin is told from the sheave, and the weight from the cabin
    assert [(x.joint, x.by) for x in led(MODEL, np.array([False, True, True]))] == [(1, 0), (2, 1)]
    # a linear equality tells either joint, a bent one the first alone
    assert [(x.joint, x.by) for x in led(MODEL, np.array([True, False, False]))] == [(0, 1)]
    assert led(MODEL, np.array([True, True, False])) == []
    (sheave,) = led(MODEL, np.array([True, False, False]))
    assert sheave.polynomial(0.6) == pytest.approx(2.0)


def test_its_motion_by_hand():
    (weight,) = led(MODEL, np.array([False, False, True]))
    q, v, a = (np.array([[0.0, x, 0.0]]) for x in (0.5, 2.0, 3.0))
    told = [float(x[0]) for x in weight.along(MODEL, q, v, a)]
    # 0.02 - x + 0.1 x^2 has the slope -1 + 0.2 x and bends by 0.2
    assert told == pytest.approx([0.02 - 0.5 + 0.025, -0.9 * 2.0, -0.9 * 3.0 + 0.2 * 4.0, -0.9])


def test_an_equality_that_is_off_tells_nothing():
    off = mujoco.MjModel.from_xml_string(LIFT.replace('joint2="sheave"', 'joint2="sheave" active="false"'))
    assert led(off, np.array([False, True, True])) == []


def test_states_that_are_taken_as_measured_follow_too():
    q = np.array([[0.0, 0.5, np.nan], [0.0, 0.7, np.nan]])
    v = np.array([[0.0, 2.0, np.nan], [0.0, 2.0, np.nan]])
    noise = Noise(np.array([1e-3, 1e-3, np.inf]), np.array([1e-2, 1e-2, np.inf]), np.zeros(3))
    (states,) = states_as_measured([Recording("ride", np.array([0.0, 0.1]), q, v)], MODEL, noise)
    np.testing.assert_allclose(states.qpos[:, 2], [-0.455, -0.631])
    np.testing.assert_allclose(states.qvel[:, 2], [-1.8, -1.72])
    np.testing.assert_allclose(states.cov[:, 2, 0, 0], 1e-6 * np.array([0.9, 0.86]) ** 2)


def test_windows_begin_where_the_machine_can_be():
    """The weight had begun at rest where the model has it, and the equality had thrown it to where it belongs."""
    rng, data, rows = np.random.default_rng(0), mujoco.MjData(MODEL), []
    recordings = []
    for k in range(3):
        mujoco.mj_resetData(MODEL, data)
        data.qpos[2], rows = 0.02, []
        for t in range(400):
            data.ctrl[0] = -30.0 + 60.0 * np.sin(0.02 * t + k)
            rows.append([*data.qpos, *data.ctrl])
            mujoco.mj_step(MODEL, data, 5)
        q, u = np.split(np.array(rows), [3], axis=1)
        q += 1e-5 * rng.standard_normal(q.shape)
        q[:, 2] = np.nan
        recordings.append(Recording(f"ride_{k}", 0.01 * np.arange(400), q, ctrl=u))
    p = prepared_of(LIFT, recordings)
    states = p.train[0].states
    x = states.qpos[:, 1]
    np.testing.assert_allclose(states.qpos[:, 2], 0.02 - x + 0.1 * x**2, atol=1e-12)
    np.testing.assert_allclose(states.qvel[:, 2], (-1.0 + 0.2 * x) * states.qvel[:, 1], atol=1e-12)
    assert "weight was never measured; it is taken to follow cabin" in " ".join(p.warnings)
