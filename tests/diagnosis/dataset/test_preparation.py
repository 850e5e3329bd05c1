"""Recordings made ready: forces between rows, noise of sparse rows, orientations."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Recording
from mpge_jax.diagnosis.dataset import preparation as preparation
from mpge_jax.diagnosis.dataset.coarse_sampling import is_coarse
from mpge_jax.diagnosis.estimation.whitening import column_scale
from mpge_jax.diagnosis.machine.model import names_of
from mpge_jax.diagnosis.recordings.states import States, estimate
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from tests.diagnosis.machines import ARM, FLYER, SERVO
from tests.diagnosis.searches import prepared_of


def test_dense_logs_are_not_coarse_and_undersampled_ones_are():
    def states(amplitude: float, frequency: float) -> bool:
        rng, model = np.random.default_rng(0), mujoco.MjModel.from_xml_string(ARM)
        time = 0.02 * np.arange(400)
        wave = 2 * np.pi * frequency
        q = amplitude * np.sin(wave * time)[:, None] * [1.0, 0.6]
        v = amplitude * wave * np.cos(wave * time)[:, None] * [1.0, 0.6]
        q, v = (x + 1e-3 * rng.standard_normal(x.shape) for x in (q, v))
        r = Recording("r", time, q, v, np.zeros((400, 2)))
        return is_coarse([r], model, estimate([r], model, names_of(model))[0])

    assert not states(0.5, 0.7)
    assert states(0.5, 21.0)


def test_a_servos_force_is_no_staircase():
    time = np.array([0.0, 1.0, 2.0])
    states = States(np.zeros((3, 1)), np.zeros((3, 1)), np.zeros((3, 1)), np.zeros((3, 1, 2, 2)))
    recording = Recording("r", time, np.zeros((3, 1)), None, np.zeros((3, 2)))
    command = np.array([[0.0, 0.0], [2.0, 2.0], [6.0, 6.0]])
    source = Source.build(recording, states, command, command * [0.0, 1.0])
    means = source.mean_command(np.array([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(means, [[0.0, 1.0], [2.0, 4.0]])


def test_a_servos_force_is_no_staircase_where_measurements_are_the_states(monkeypatch):
    model = mujoco.MjModel.from_xml_string(SERVO)
    recordings, felt = [], []
    for k in range(4):
        data, rows, time = mujoco.MjData(model), [], 0.02 * np.arange(120)
        for t in time:
            data.ctrl[:] = np.sin(3.0 * t + k)
            mujoco.mj_forward(model, data)
            rows.append([data.qpos[0], data.qvel[0], data.ctrl[0], data.actuator_force[0]])
            for _ in range(10):
                mujoco.mj_step(model, data)
                felt.append(float(data.actuator_force[0]))
        q, v, u, f = np.array(rows).T[..., None]
        recordings.append(Recording(f"run_{k}", time, q, v, u, f))
    monkeypatch.setattr(preparation, "is_coarse", lambda *_: True)
    monkeypatch.setattr(preparation, "bound", lambda *args: dataclasses.replace(args[2], direct=True))
    source = prepared_of(SERVO, recordings).train[0]
    force = source.recording.force
    np.testing.assert_array_equal(source.states.qpos, source.recording.qpos)
    # the last row lasts for no time
    mine, rows = int(source.recording.name.removeprefix("run_")), source.recording.time.size
    actual = 0.02 * np.mean(np.reshape(felt, (4, 120, 10))[mine, : rows - 1], axis=1)
    straight = 0.02 * 0.5 * (force[:-1, 0] + force[1:, 0])
    error, error_of_line = (np.abs(x - actual).max() for x in (np.diff(source.integral[:, 0]), straight))
    assert error < 0.2 * error_of_line


@pytest.mark.parametrize("pose", [[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, -0.5, 0.5]])
def test_noise_of_an_orientation_does_not_depend_on_the_pose(pose):
    rng, sigma, rows = np.random.default_rng(0), 1e-3, 400
    model = mujoco.MjModel.from_xml_string(FLYER)
    qpos = np.zeros((rows, 7))
    for row in qpos:
        row[3:] = pose
        mujoco.mj_integratePos(model, row, np.r_[0, 0, 0, sigma * rng.standard_normal(3)], 1.0)
    recording = Recording("r", 0.01 * np.arange(rows), qpos, None, np.zeros((rows, 1)))
    noise, states, _ = estimate([recording], model, names_of(model))
    assert noise.angle(3) == pytest.approx(sigma, rel=0.15)
    np.testing.assert_allclose(column_scale(noise, model)[3:6], noise.angle(3))
    np.testing.assert_allclose(states[0].cov[:, 3:6, 0, 0], noise.angle(3) ** 2)
