"""A gap between motor and link: the bounce at its ends, and the inertia that is struck."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.effects.base import REGISTRY, find_place
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.drive.backlash import BOUNCE, damping_ratio, restitution_of
from mpge_jax.diagnosis.machine.model import compile_variable, free_inertia

LINK = """<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5" contype="0" conaffinity="0"/>"""
TREE = f"""<mujoco><worldbody><body><freejoint/>{LINK}<body><joint name="left" axis="0 1 0"/>{LINK}
<body pos="0 0 -.3"><joint name="knee" axis="0 1 0"/>{LINK}</body></body>
<body><joint name="right" axis="1 0 0" armature="0.02"/>{LINK}</body></body></worldbody></mujoco>"""
PULSE, STEPS = 0.5, 10


def _machine(
    rotor: float,
    gap: float,
    restitution: float,
    timestep: float = 1e-3,
    integrator: str = "Euler",
    joint: str = "",
) -> CorrectedModel:
    xml = f"""<mujoco><option gravity="0 0 0" timestep="{timestep}" integrator="{integrator}"/>
    <worldbody><body name="arm"><joint name="hinge" axis="0 1 0" armature="{rotor}" {joint}/>{LINK}</body></worldbody>
    <actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
    entry = {"id": "backlash", "at": "hinge", "kind": "joint"}
    entry["parameters"] = {"gap": gap, "restitution": restitution}
    return CorrectedModel.build(mujoco.MjSpec.from_string(xml), [entry])


@pytest.mark.parametrize("restitution", [0.1, 0.3, 0.7])
@pytest.mark.parametrize("heavy", [0.1, 1.0, 8.0])
def test_a_motor_bounces_off_the_link_with_its_restitution(heavy, restitution):
    """A motor of inertia I that is `heavy` times the link's M comes at speed u and leaves the link, which was at rest,
    at (1 + e) u I / (I + M)."""
    probe = _machine(1.0, 0.2, 0.0)
    data = mujoco.MjData(probe.machine.model)
    mujoco.mj_forward(probe.machine.model, data)
    link = float(free_inertia(probe.machine.model, data.qLD, 0))
    motor = heavy * link
    stepper = _machine(motor, 0.2, restitution).c_stepper()
    stepper.reset(np.zeros(1), np.zeros(1))
    stepper.step(np.zeros(1))
    pulse = PULSE * heavy
    stepper.step(np.array([pulse]), STEPS)
    speed = pulse * STEPS * 1e-3 / motor
    # half the gap, and the contact's few milliseconds
    struck = int(0.1 / speed / 1e-3) + 10
    stepper.step(np.zeros(1), struck)
    expected = (1.0 + restitution) * speed * motor / (motor + link)
    assert stepper.data.qvel[0] == pytest.approx(expected, rel=0.03)


# A Latin square: every two of the three values meet; in the fast tests each value once.
@pytest.mark.parametrize(
    ("rotor", "restitution", "integrator"),
    [
        (0.015, 0.1, "Euler"), (0.15, 0.5, "implicitfast"), (0.5, 0.9, "RK4"),
        *(
            pytest.param(*values, marks=pytest.mark.slow)
            for values in (
                (0.015, 0.5, "RK4"), (0.015, 0.9, "implicitfast"), (0.15, 0.1, "RK4"),
                (0.15, 0.9, "Euler"), (0.5, 0.1, "implicitfast"), (0.5, 0.5, "Euler"),
            )
        ),
    ],
)  # fmt: skip
def test_a_motor_rests_against_a_link_that_is_held(rotor, restitution, integrator):
    """A joint limit holds the link, of 0.015 kg m^2, against 2 N m: all of them pass, and the motor is still."""
    held = 'limited="true" range="-0.001 0.001" damping="0.01"'
    stepper = _machine(rotor, 0.02, restitution, 1e-3, integrator, held).c_stepper()
    stepper.reset(np.zeros(1), np.zeros(1))
    stepper.step(np.array([2.0]), 4000)
    passed = []
    for _ in range(200):
        stepper.step(np.array([2.0]))
        passed.append(float(stepper.data.qfrc_applied[0]) + 2.0)
    assert np.mean(passed) == pytest.approx(2.0, abs=0.05) and np.std(passed) < 0.05
    assert abs(stepper._forces[0][1]) < 0.03


def test_steps_of_the_engine_do_not_decide_the_bounce():
    speeds = []
    for timestep, integrator in ((5e-4, "Euler"), (1e-3, "RK4"), (1e-3, "implicitfast"), (2e-3, "Euler")):
        stepper = _machine(0.03, 0.1, 0.3, timestep, integrator).c_stepper()
        stepper.reset(np.zeros(1), np.zeros(1))
        stepper.step(np.zeros(1))
        stepper.step(np.array([0.5]), round(0.02 / timestep))
        stepper.step(np.zeros(1), round(0.3 / timestep))
        speeds.append(float(stepper.data.qvel[0]))
    np.testing.assert_allclose(speeds, speeds[0], rtol=0.02)


def test_a_free_joints_inertia_is_that_of_the_inverse_mass_matrix():
    model = compile_variable(mujoco.MjSpec.from_string(TREE))
    data = mujoco.MjData(model)
    data.qpos[7:] = 0.5, -1.0, 0.7
    mujoco.mj_forward(model, data)
    inverse = np.zeros((model.nv, model.nv))
    mujoco.mj_solveM(model, data, inverse, np.eye(model.nv))
    for dof in range(model.nv):
        assert free_inertia(model, data.qLD, dof) == pytest.approx(1.0 / inverse[dof, dof])
    both = np.stack([data.qLD, 2.0 * data.qLD])
    assert free_inertia(model, both, 7).shape == (2,)


def test_a_damper_gives_back_the_share_of_the_speed_that_it_was_made_for():
    # exp(-2 z arccos z / sqrt(1 - z^2)), at z = 1/2 and in the limit at z = 1
    half, one = np.exp(-2.0 * np.pi / 27**0.5), np.exp(-2.0)
    np.testing.assert_allclose(restitution_of(np.array([0.0, 0.5, 1.0])), [1.0, half, one], atol=1e-6)
    np.testing.assert_allclose(damping_ratio(np, np.array([1.0, half, 0.0])), [0.0, 0.5, 2.0], atol=1e-4)


def test_a_gap_is_enough_to_make_a_backlash():
    model = _machine(0.02, 0.1, 0.3).machine.ctx.model
    ctx, effect = nominal_context(model), REGISTRY["backlash"]
    place = find_place(ctx, effect, "hinge")
    np.testing.assert_array_equal(effect.from_report(ctx, place, {"gap": 0.1}), [0.1, BOUNCE])
    given = effect.from_report(ctx, place, {"gap": 0.1, "restitution": 0.5})
    np.testing.assert_array_equal(given, [0.1, 0.5])
