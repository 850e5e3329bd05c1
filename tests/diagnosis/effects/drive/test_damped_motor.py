"""A flexible drive whose joint is damped at its motor: against two bodies of MuJoCo's own."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Recording
from mpge_jax.diagnosis.corrected.corrected_model import CorrectedModel
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.selection.backward_elimination import final_fit
from mpge_jax.diagnosis.selection.closer_forms import closer
from tests.diagnosis.machines import entry, excitation
from tests.diagnosis.searches import HINGE, fitted, reported, search_of

LINK = '<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5" contype="0" conaffinity="0"/>'
NOMINAL = f"""<mujoco><option timestep="0.005" integrator="implicitfast"/><worldbody><body name="arm">
<joint name="hinge" axis="0 1 0" armature="0.02" damping="0.3"/>{LINK}</body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
STIFFNESS, DAMPING = 12.0, 0.1


def two_bodies(share: float) -> mujoco.MjModel:
    """`share` of the damping at the shaft, the rest at the link."""
    return mujoco.MjModel.from_xml_string(f"""<mujoco><option timestep="0.0005" integrator="implicitfast"/><worldbody>
    <body name="arm"><joint name="hinge" axis="0 1 0" damping="{0.3 * (1 - share)}"/>{LINK}</body>
    <body name="rotor"><joint name="shaft" axis="0 1 0" armature="0.02" damping="{0.3 * share}"/>
    <geom size=".001" mass="1e-6" contype="0" conaffinity="0"/></body></worldbody>
    <tendon><fixed name="spring" stiffness="{STIFFNESS}" damping="{DAMPING}" springlength="0">
    <joint joint="shaft" coef="1"/><joint joint="hinge" coef="-1"/></fixed></tendon>
    <actuator><motor name="motor" joint="shaft"/></actuator></mujoco>""")


def recorded(share: float) -> list[Recording]:
    rng, model, out = np.random.default_rng(0), two_bodies(share), []
    for k in range(4):
        data, rows = mujoco.MjData(model), []
        for i in range(301):
            u = excitation(k, 0.01 * i, np.array([0.7 * k]), np.array([1.0]))
            rows.append((data.qpos[:1] + 1e-4 * rng.standard_normal(1), u))
            data.ctrl[:] = u
            mujoco.mj_step(model, data, 20)
        q, u = (np.array(x) for x in zip(*rows, strict=True))
        out.append(Recording(f"run_{k}", 0.01 * np.arange(301), q, None, u))
    return out


def test_it_moves_as_two_bodies_do():
    entries = [
        {**entry("joint_flexibility", "hinge", "joint", stiffness=STIFFNESS, damping=DAMPING), **more}
        for more in ({}, {"form": "joint_flexibility:damped_motor"})
    ]
    entries[1]["parameters"] = {**entries[1]["parameters"], "motor_share": 1.0}
    fine = NOMINAL.replace("0.005", "0.001")
    plain, damped = (CorrectedModel.build(mujoco.MjSpec.from_string(fine), [e]).c_stepper() for e in entries)
    model = two_bodies(1.0)
    data, errors = mujoco.MjData(model), []
    # as one, the motor is held back by its damping from the start
    data.qvel[:] = 2.0
    data.qpos[1] = -0.3 * 2.0 / STIFFNESS
    for stepper in (plain, damped):
        stepper.reset(np.zeros(1), np.full(1, 2.0))
    for k in range(200):
        data.ctrl[:] = u = np.array([np.sign(np.sin(0.1 * k))])
        mujoco.mj_step(model, data, 20)
        for stepper in (plain, damped):
            stepper.step(u, 10)
        errors.append([stepper.data.qpos[0] - data.qpos[0] for stepper in (plain, damped)])
    without, with_it = np.sqrt(np.mean(np.square(errors), axis=0))
    assert with_it < 0.15 * without


@pytest.mark.parametrize("share", [1.0, pytest.param(0.0, marks=pytest.mark.slow)])
def test_it_is_asked_for_where_a_drive_yields(share):
    s = search_of(NOMINAL, recorded(share))[0]
    plain = final_fit(s, fitted(s, {Term("joint_flexibility", HINGE): [STIFFNESS, DAMPING]}))[0]
    found = closer(s, plain)
    if not share:
        assert found is plain
        return
    assert [t.id for t in found.hypothesis.terms] == ["joint_flexibility:damped_motor"]
    values = reported(s, found)
    assert values["motor_share"] == pytest.approx(1.0, abs=0.1)
    assert values["stiffness"] == pytest.approx(STIFFNESS, rel=0.1)


def test_a_joint_without_damping_has_no_such_form():
    s = search_of(NOMINAL.replace(' damping="0.3"', ""), recorded(0.0))[0]
    current = fitted(s, {Term("joint_flexibility", HINGE): [STIFFNESS, DAMPING]})
    assert closer(s, current) is current
    assert not any(line.startswith("closer forms") for line in s.log)
