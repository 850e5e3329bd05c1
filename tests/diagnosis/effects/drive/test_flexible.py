"""A flexible drive against what two bodies on a spring do by Newton's law."""

import mujoco
import numpy as np
import pytest
from scipy.linalg import expm

from mpge_jax.diagnosis.corrected.corrected_model import CorrectedModel
from mpge_jax.diagnosis.effects.drive.flexible import _swung
from tests.diagnosis.machines import entry

MOTOR, LINK = 0.0012, 0.004
TURNTABLE = """<mujoco><option timestep="{dt}" integrator="{integrator}" gravity="0 0 0"/><worldbody><body name="table">
<inertial pos="0 0 0" mass="1" diaginertia="0.004 0.004 0.004"/><joint name="turn" axis="0 0 1" armature="0.0012"/>
</body></worldbody><actuator><motor name="motor" joint="turn"/></actuator></mujoco>"""


def _simulated(dt: float, integrator: str, stiffness: float, damping: float, seconds: float) -> np.ndarray:
    """Speeds of the link after each step, under a torque of 0.5 N m for 20 ms."""
    spec = mujoco.MjSpec.from_string(TURNTABLE.format(dt=dt, integrator=integrator))
    row = entry("joint_flexibility", "turn", "joint", stiffness=stiffness, damping=damping)
    stepper, out = CorrectedModel.build(spec, [row]).c_stepper(), []
    stepper.reset(np.zeros(1), np.zeros(1))
    # the spring begins as its torque of the moment has it
    stepper.step(np.zeros(1), 1)
    for k in range(round(seconds / dt)):
        stepper.step(np.array([0.5 * (k * dt < 0.02 - 1e-9)]), 1)
        out.append(stepper.data.qvel[0])
    return np.array(out)


def _by_newton(dt: float, stiffness: float, damping: float, seconds: float) -> np.ndarray:
    passed = np.array([stiffness, damping, -stiffness, -damping, 0.0])
    rates = np.zeros((5, 5))
    rates[0, 1] = rates[2, 3] = 1.0
    rates[1], rates[3] = -passed / MOTOR, passed / LINK
    rates[1, 4] = 1.0 / MOTOR
    step, x, out = expm(rates * dt), np.zeros(5), []
    for k in range(round(seconds / dt)):
        x[4] = 0.5 * (k * dt < 0.02 - 1e-9)
        x = step @ x
        out.append(x[3])
    return np.array(out)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize("dt", [0.001, 0.002])
def test_it_swings_and_fades_as_two_bodies_do(integrator, dt):
    """At 54 Hz, with a fifth of the critical damping: taken step by step, the motor lost a third more than that."""
    simulated, true = _simulated(dt, integrator, 110.0, 0.12, 0.2), _by_newton(dt, 110.0, 0.12, 0.2)
    swings = true - true[-1]
    assert np.abs(swings).max() > 0.5
    np.testing.assert_allclose(simulated, true, atol=(0.01 if dt == 0.001 else 0.03) * np.abs(swings).max())


@pytest.mark.parametrize("hertz", [200.0, 1000.0, 5000.0])
def test_a_drive_that_is_stiffer_than_steps_can_follow_moves_as_if_it_were_rigid(hertz):
    stiffness = (2 * np.pi * hertz) ** 2 * MOTOR * LINK / (MOTOR + LINK)
    speeds = _simulated(0.002, "implicitfast", stiffness, 0.3 * stiffness / (np.pi * hertz), 0.3)
    # 0.5 N m for 20 ms on both
    assert speeds[20:] == pytest.approx(0.01 / (MOTOR + LINK), rel=0.02)
    assert np.abs(speeds).max() < 1.5 * 0.01 / (MOTOR + LINK)


@pytest.mark.parametrize(
    ("square", "friction"), [(400.0, 3.0), (400.0, 40.0), (400.0, 400.0), (1e6, 10.0), (1e-2, 0.0)]
)
def test_a_swing_is_exact_however_it_is_damped(square, friction):
    """It swings, is damped critically, creeps, is stiff, or next to free."""
    push, x, speed, h = 5.0, 0.01, 0.3, 0.01
    rates = np.array([[0.0, 1.0, 0.0], [-square, -friction, 1.0], [0.0, 0.0, 0.0]])
    true = (expm(rates * h) @ [x, speed, push])[:2] - [x, speed]
    given = (np.array(value) for value in (square, friction, push, x, speed))
    np.testing.assert_allclose(_swung(np, *given, h), true, rtol=1e-6, atol=1e-12)
