"""What held commands make of the motion between slow rows is known to the smoother."""

from copy import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Recording
from mpge_jax.diagnosis.machine.model import names_of
from mpge_jax.diagnosis.recordings.measurement_noise import noise_of
from mpge_jax.diagnosis.recordings.rows.command_jumps import FADES, answer, command_jumps, lasting
from mpge_jax.diagnosis.recordings.states import smoothed, told_with_commands

ARM = """<mujoco><option timestep="0.0005"/><worldbody><body><joint name="hinge" axis="0 1 0" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5" contype="0" conaffinity="0"/></body></worldbody>
<actuator><position name="servo" joint="hinge" kp="{kp}" kv="0.6" ctrlrange="-1 1"/></actuator></mujoco>"""
ROW = 0.03


def _recorded(model: mujoco.MjModel) -> tuple[Recording, np.ndarray]:
    """Rows of 30 ms with noise of 0.05 mrad, and the true velocities."""
    rng, data, rows = np.random.default_rng(0), mujoco.MjData(model), []
    for i in range(150):
        t = ROW * i
        data.ctrl[:] = 0.6 * np.sin(3.1 * t) + 0.3 * np.sin(8.3 * t)
        mujoco.mj_forward(model, data)
        rows.append((t, data.qpos.copy(), data.qvel.copy(), data.ctrl.copy()))
        mujoco.mj_step(model, data, round(ROW / model.opt.timestep))
    time, q, v, u = (np.array(x) for x in zip(*rows, strict=True))
    return Recording("r", time, q + 5e-5 * rng.standard_normal(q.shape), None, u), v


def test_an_acceleration_jumps_by_what_a_command_does_to_it():
    model = mujoco.MjModel.from_xml_string(ARM.format(kp=8))
    data, full = mujoco.MjData(model), np.zeros((1, 1))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    # beyond its limit a command does no more
    u = np.array([[0.0], [0.5], [0.5], [3.0]])
    r = Recording("r", ROW * np.arange(4), np.zeros((4, 1)), None, u)
    expected = 8 * np.array([[0.0], [0.5], [0.0], [0.5]]) / full
    np.testing.assert_allclose(command_jumps(r, model), expected, rtol=1e-9)
    assert not command_jumps(replace(r, ctrl=None), model).any()


def test_what_a_jump_makes_fades():
    """a(t) = exp(-t / T): v = T (1 - exp(-t / T)), q = T (t - v)."""
    time, jumps = np.arange(5) * 0.1, np.zeros((5, 1))
    jumps[1] = 2.0
    t, fades = time[1:] - 0.1, lasting(time)
    assert fades == pytest.approx(FADES * 0.1)
    q, v, a = answer(time, jumps)
    np.testing.assert_allclose(v[1:, 0], 2.0 * fades * (1 - np.exp(-t / fades)), atol=1e-15)
    np.testing.assert_allclose(q[1:, 0], 2.0 * fades * (t - fades * (1 - np.exp(-t / fades))), atol=1e-15)
    # at the row of the jump half of it
    np.testing.assert_allclose(a[:, 0], [0.0, 1.0, *2.0 * np.exp(-t[1:] / fades)], atol=1e-15)


@pytest.mark.parametrize(("given", "heeded"), [(8, True), (-8, False)])
def test_velocities_at_slow_rows_are_told_with_commands_where_that_makes_positions_likelier(given, heeded):
    """The model is right, or has its servo drive the other way."""
    model = mujoco.MjModel.from_xml_string(ARM.format(kp=8))
    r, true = _recorded(model)
    noise, _ = noise_of([r], model, names_of(model))
    jumps, plain = command_jumps(r, model), copy(model)
    plain.actuator_gainprm[0, 0] = given
    (without,) = smoothed([r], model, noise)
    (told,) = told_with_commands([r], model, noise, plain, 1)
    error, before = (np.sqrt(np.mean((x.qvel - true)[5:-5] ** 2)) for x in (told, without))
    if heeded:
        assert error < 0.35 * before
        np.testing.assert_array_equal(told.jumps, jumps)
        # once it is known which are heeded they are told alike
        np.testing.assert_allclose(smoothed([r], model, noise, [jumps])[0].qvel, told.qvel)
    else:
        assert told.jumps is None or not told.jumps.any()
        np.testing.assert_array_equal(told.qvel, without.qvel)


def test_rows_as_fast_as_the_models_steps_are_told_without():
    model = mujoco.MjModel.from_xml_string(ARM.format(kp=8))
    r, _ = _recorded(model)
    noise, _ = noise_of([r], model, names_of(model))
    model.opt.timestep = ROW / 7
    (told,) = told_with_commands([r], model, noise, model, 1)
    assert told.jumps is None
