"""Noise in measured forces: taken out where the motor's law is known, left where it is none."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.drives.command_to_force import diagnose_actuators
from mpge_jax.diagnosis.drives.force_noise import freed
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.evidence.null_distribution import force_noise
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.recordings.validation import validate
from tests.diagnosis.machines import FINE_PENDULUM, excitation

DRIVES = [i for i, e in REGISTRY.items() if e.side == "actuator"]
NOISE, MORE = 0.05, 0.15


def _recordings(ripple: float = 0.0, sensor: float = 0.0, gain: float = 1.0, more: slice = slice(0)):
    """A motor with noise in its force (`ripple`) and in the measurement of that; in some rows of the first run it gives
    more than its command."""
    rng, out = np.random.default_rng(0), []
    model = mujoco.MjModel.from_xml_string(FINE_PENDULUM)
    for k in range(4):
        data, rows = mujoco.MjData(model), []
        for i in range(400):
            u = excitation(k, 0.01 * i, np.array([k]), np.array([0.8]))
            force = gain * u + ripple * rng.standard_normal(1)
            force += MORE * (k == 0 and more.start is not None and more.start <= i < more.stop)
            rows.append((0.01 * i, data.qpos.copy(), u, force + sensor * rng.standard_normal(1)))
            data.ctrl[:] = 0.0
            data.qfrc_applied[:] = force
            mujoco.mj_step(model, data, 5)
        time, q, u, force = (np.array(x) for x in zip(*rows, strict=True))
        out.append(Recording(f"run_{k}", time, q + 1e-5 * rng.standard_normal(q.shape), None, u, force))
    return out


def _freed(recordings):
    spec = mujoco.MjSpec.from_string(FINE_PENDULUM)
    plain = compile_variable(spec)
    p = prepare(spec, [validate(r, plain, names_of(plain)) for r in recordings], Config(jobs=1))
    found = diagnose_actuators(p, plain, DRIVES)
    assert found is not None
    return p, freed(p, plain, found)


@pytest.mark.parametrize("gain", [1.0, 0.7])
def test_a_noisy_measurement_gives_way_to_the_law(gain):
    p, out = _freed(_recordings(sensor=NOISE, gain=gain))
    assert out.known is not None and out.known.tolist() == [True]
    assert force_noise(p)[0] == pytest.approx(NOISE, rel=0.2) and force_noise(out)[0] == 0.0
    for s in out.train:
        # the gain was fitted to a thousand rows
        np.testing.assert_allclose(s.command, gain * s.recording.known("ctrl"), atol=0.2 * NOISE)


def test_forces_that_really_shake_stay_as_measured():
    p, out = _freed(_recordings(ripple=NOISE))
    assert out is p and out.known is None


def test_forces_without_noise_stay_as_measured():
    p, out = _freed(_recordings())
    assert out is p


def test_a_stretch_in_which_the_law_does_not_hold_stays_as_measured():
    _, out = _freed(_recordings(sensor=NOISE, more=slice(200, 225)))
    assert out.known is not None
    for s in (*out.train, *out.test):
        if s.recording.name == "run_0":
            np.testing.assert_array_equal(s.command[200:225], s.recording.known("force")[200:225])
        else:
            np.testing.assert_allclose(s.command, s.recording.known("ctrl"), atol=1e-9)


def test_a_law_that_fails_widely_is_not_believed():
    _, out = _freed(_recordings(sensor=NOISE, more=slice(100, 300)))
    assert out.known is None
