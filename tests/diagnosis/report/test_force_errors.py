"""Recordings of motion and force without commands: the force is predicted, and errors are in its units."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, InputError, Recording, diagnose
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.recordings.validation import validate
from tests.diagnosis.machines import ARM, PENDULUM, excitation

GEAR = 20.0
GEARED = PENDULUM.replace('joint="hinge" ctrl', f'joint="hinge" gear="{GEAR}" ctrl')


def _bench(xml, size, friction, seed=0):
    """Three recordings of motion and force of a pendulum with dry friction; no commands."""
    rng, out = np.random.default_rng(seed), []
    for k in range(3):
        model = mujoco.MjModel.from_xml_string(xml)
        model.opt.timestep /= 4
        data = mujoco.MjData(model)
        data.qpos[:] = rng.uniform(-0.3, 0.3, 1)
        rows = []
        for i in range(201):
            data.ctrl[:] = excitation(k, 0.01 * i, rng.uniform(0, 6, 1) * 0, np.array([size]))
            data.qfrc_applied[:] = 0
            mujoco.mj_forward(model, data)
            rows.append((0.01 * i, data.qpos.copy(), data.actuator_force.copy()))
            for _ in range(round(0.01 / model.opt.timestep)):
                data.qfrc_applied[0] = -friction * np.tanh(data.qvel[0] / 0.02)
                mujoco.mj_step(model, data)
        time, qpos, force = (np.array(x) for x in zip(*rows, strict=True))
        qpos = qpos + 1e-4 * rng.standard_normal(qpos.shape)
        force = force + 2e-4 * rng.standard_normal(force.shape)
        out.append(Recording(f"run_{k}", time, qpos, None, None, force))
    return out


def test_a_geared_bench_without_commands_is_judged_in_force_units(tmp_path):
    config = Config(jobs=1, effects=("coulomb_friction", "viscous_damping", "actuator_gain"))
    d = diagnose(mujoco.MjSpec.from_string(GEARED), _bench(GEARED, 0.07, 0.1), config)
    table = d.to_json()
    assert [t.id for t in d.terms] == ["coulomb_friction"]
    assert table["effects"][0]["parameters"]["torque"]["value"] == pytest.approx(0.1, rel=0.05)
    fit = table["fit"]
    assert fit["unit"] == "N m"
    held = fit["held_out"]
    # friction of 0.1 N m at the joint is 0.005 N m before the gear
    assert held["before"] == pytest.approx(0.1 / GEAR, rel=0.2)
    assert held["after"] < 0.5 * held["before"]
    assert 0.3 * held["after"] < held["noise_floor"] < 1.2 * held["after"]
    assert held["per_joint"] == {"hinge": [held["before"], held["after"]]}
    assert "actuator force" in table["explanation"] and "N m" in table["explanation"]
    d.write(tmp_path)
    assert "by inverse dynamics" in (tmp_path / "report.html").read_text()


def test_an_actuator_without_command_and_force_is_refused():
    model = compile_variable(mujoco.MjSpec.from_string(ARM))
    force = np.zeros((20, 2))
    force[:, 1] = np.nan
    r = Recording("run", 0.01 * np.arange(20), np.zeros((20, 2)), None, None, force)
    with pytest.raises(InputError, match=r"run: nothing tells what elbow_servo did.*record one"):
        validate(r, model, names_of(model))
