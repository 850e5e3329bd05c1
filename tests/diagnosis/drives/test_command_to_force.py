"""Effects between commands and measured forces."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording, diagnose
from mpge_jax.diagnosis.dataset.prepared import with_drives
from mpge_jax.diagnosis.drives.command_to_force import diagnose_actuators
from tests.diagnosis.machines import FINE_PENDULUM
from tests.diagnosis.searches import search_of


def test_actuator_effects_show_in_the_prediction_from_commands():
    gain, recordings = 0.7, []
    model = mujoco.MjModel.from_xml_string(FINE_PENDULUM)
    model.opt.timestep /= 4
    rng = np.random.default_rng(0)
    for k in range(4):
        data, rows = mujoco.MjData(model), []
        data.qpos[0] = 0.3 * k
        for i in range(200):
            u = np.sin(0.03 * i * (k + 1)) + 0.4 * np.sign(np.sin(0.11 * i))
            rows.append((0.01 * i, data.qpos[0], u, gain * u))
            data.ctrl[0] = gain * u
            mujoco.mj_step(model, data, 20)
        t, q, u, f = np.array(rows).T
        q = q + 1e-4 * rng.standard_normal(q.size)
        f = f + 1e-3 * rng.standard_normal(f.size)
        recordings.append(Recording(f"run_{k}", t, q[:, None], None, u[:, None], f[:, None]))
    d = diagnose(mujoco.MjSpec.from_string(FINE_PENDULUM), recordings, Config(jobs=1))
    found = d.to_json()
    assert [(e["id"], e["at"]) for e in found["effects"]] == [("actuator_gain", "motor")]
    assert d.held.before.rms > 10 * d.held.after.rms
    # nothing is missing in the machine itself
    assert d.terms == () and [str(t) for t in d.named] == ["actuator_gain@motor"]


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_back_emf_is_read_from_measured_forces_on_a_jittered_clock(jitter):
    """The command changes at the rows themselves, and the force follows the speed between them."""
    coefficient, recordings = 0.3, []
    rng, plain = np.random.default_rng(0), mujoco.MjModel.from_xml_string(FINE_PENDULUM)
    for k in range(3):
        t = np.cumsum(0.01 * (1 + jitter * rng.uniform(-1, 1, 150)))
        q, v = np.sin(3 * t + k), 3 * np.cos(3 * t + k)
        u = np.sin((k + 2) * t) + 0.8 * np.sign(np.sin(25 * t))
        f = u - coefficient * v + 1e-3 * rng.standard_normal(t.size)
        q = q + 1e-4 * rng.standard_normal(t.size)
        recordings.append(Recording(f"run_{k}", t, q[:, None], None, u[:, None], f[:, None]))
    p = search_of(FINE_PENDULUM, recordings)[1]
    found = diagnose_actuators(p, plain, ["actuator_gain", "actuator_bias", "actuator_delay", "back_emf"])
    assert [e["id"] for e in found.effects] == ["back_emf"]
    assert found.effects[0]["parameters"]["coefficient"]["value"] == pytest.approx(coefficient, rel=0.02)
    # between rows, the integral of the measured force follows the speed and keeps the steps of the command
    source = with_drives(p, plain, *found.between_rows(plain)).train[0]
    r, steps = source.recording, np.diff(source.recording.time)
    follows = (r.force - r.ctrl)[:, 0]
    mean = r.ctrl[:-1, 0] + 0.5 * (follows[:-1] + follows[1:])
    mean = mean - steps**2 / 12 * source.bend[:, 0]
    assert source.bend.any()
    np.testing.assert_allclose(np.diff(source.integral[:, 0]), steps * mean, atol=1e-4 * steps.mean())
