"""Friction under load at joints that tendons pull: the load is a tension times its lever arm."""

import mujoco
import pytest

from mpge_jax.diagnosis.effects.candidates import all_terms
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.machine.model import compile_variable, lever_arms
from mpge_jax.diagnosis.selection.forward_selection import search
from tests.diagnosis.machines import really_sticks, record
from tests.diagnosis.searches import search_of

FINGER = """<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody>
<body name="proximal"><joint name="mcp" axis="0 1 0" stiffness=".2" damping=".003" armature="3e-5"/>
<geom type="capsule" fromto="0 0 0 .05 0 0" size=".009" mass=".06" contype="0" conaffinity="0"/>
<body name="middle" pos=".05 0 0"><joint name="pip" axis="0 1 0" stiffness=".12" damping=".002" armature="2e-5"/>
<geom type="capsule" fromto="0 0 0 .035 0 0" size=".008" mass=".04" contype="0" conaffinity="0"/></body></body>
</worldbody>
<tendon><fixed name="flexor"><joint joint="mcp" coef=".012"/><joint joint="pip" coef=".01"/></fixed>
<fixed name="extensor"><joint joint="mcp" coef="-.011"/></fixed></tendon>
<actuator><motor name="pull" tendon="flexor" gear="2" ctrlrange="0 12"/>
<motor name="back" tendon="extensor" ctrlrange="0 12"/></actuator></mujoco>"""
COULOMB, SHARE = 0.002, 0.15
TERM = "load_dependent_friction@pip"


def test_lever_arms_are_those_of_the_tendons_times_the_gear():
    m = mujoco.MjModel.from_xml_string(FINGER)
    assert lever_arms(m, m.joint("mcp").id) == [(0, pytest.approx(0.024)), (1, pytest.approx(-0.011))]
    assert lever_arms(m, m.joint("pip").id) == [(0, pytest.approx(0.02))]


def test_it_may_act_wherever_a_tendon_pulls():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(FINGER)))
    assert {"load_dependent_friction@mcp", TERM} <= {str(t) for t in all_terms(ctx)}


def test_it_is_found_with_its_share_of_the_tension_s_torque():
    """0.002 N m and 0.15 of a torque of at most 0.24 N m."""

    def force(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        model.dof_frictionloss[1] = COULOMB + SHARE * abs(0.02 * data.actuator_force[0])

    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] = COULOMB
        really_sticks(model, 1)

    s, _ = search_of(FINGER, record(FINGER, [5.0, 5.0], change=change, force=force, count=4, seconds=4.0))
    found = search(s)[0]
    assert [str(t) for t in found.hypothesis.named] == [TERM]
    coulomb, share = found.theta[:2]
    assert coulomb == pytest.approx(COULOMB, abs=5e-4) and share == pytest.approx(SHARE, rel=0.05)
