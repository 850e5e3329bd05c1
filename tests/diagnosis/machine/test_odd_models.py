"""Models whose parts are named, driven or put together in ways that mislead."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.corrected.mjcf import with_comment
from mpge_jax.diagnosis.effects.base import REGISTRY, find_place
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec, moving_bodies, names_of
from tests.diagnosis.machines import entry

LINK = """<body {body} pos="{x} 0 0"><joint {joint} axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" contype="0" conaffinity="0"/></body>"""


def _link(x: int, joint: str = "", body: str = "") -> str:
    return LINK.format(x=x, joint=joint, body=body)


def test_names_that_are_made_up_are_nobodys():
    bodies = _link(0) + _link(1, 'name="joint_0"') + _link(2, 'name="j"', 'name="body_1"')
    motors = "".join(f"<motor {name}/>" for name in ('joint="joint_0"', 'name="joint_0" joint="j"'))
    xml = f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"
    names = names_of(mujoco.MjModel.from_xml_string(xml))
    assert names.joints == ("joint_0_", "joint_0", "j")
    assert names.actuators == ("actuator_0", "joint_0")
    assert names.bodies == ("world", "body_1_", "body_2", "body_1")
    damped = CorrectedModel.build(
        mujoco.MjSpec.from_string(xml), [entry("viscous_damping", "joint_0", "joint", coefficient=3.0)]
    )
    assert damped.machine.model.dof_damping.tolist() == [0.0, 3.0, 0.0]


def test_no_force_acts_on_what_is_moved_by_hand():
    ball = '<body name="{}" pos="{} 0 0" {}>{}<geom size=".1" contype="0" conaffinity="0"/></body>'
    hand = ball.format("hand", 0, 'mocap="true"', "")
    xml = f"<mujoco><worldbody>{hand}{ball.format('free', 1, '', '<freejoint/>')}</worldbody></mujoco>"
    spec = mujoco.MjSpec.from_string(xml)
    model = compile_variable(spec)
    assert moving_bodies(model) == [2]
    pushed = CorrectedModel.build(spec, [entry("external_force", "world", "world", force=[1.0, 0.0, 0.0])])
    stepper = pushed.c_stepper()
    stepper.reset(model.qpos0, np.zeros(model.nv))
    stepper.step(np.zeros(0))
    assert stepper.data.qvel[0] / model.opt.timestep == pytest.approx(1.0 / model.body_mass[2])


@pytest.mark.parametrize("gripper", ["", '<motor name="grip" tendon="grip"/>'])
def test_a_joints_limit_comes_last_whatever_else_the_model_drives(gripper):
    fingers = '<body pos="{} 0 0"><joint name="{}" type="slide" axis="1 0 0"/><geom size=".05"/></body>'
    xml = f"""<mujoco><option gravity="0 0 0"/><worldbody>{_link(0, 'name="arm" actuatorfrcrange="-5 5"')}
    {fingers.format(1, "left")}{fingers.format(2, "right")}</worldbody><tendon><fixed name="grip">
    <joint joint="left" coef="1"/><joint joint="right" coef="-1"/></fixed></tendon>
    <actuator><motor name="arm" joint="arm"/>{gripper}</actuator></mujoco>"""
    spec = load_spec(mujoco.MjSpec.from_string(xml))
    stepper = CorrectedModel.build(
        spec, [entry("actuator_deadzone", "arm", "actuator", width=1.0)]
    ).c_stepper()
    stepper.reset(np.zeros(3), np.zeros(3))
    stepper.step(np.array([10.0, 0.0] if gripper else [10.0]))
    # 9 N m behind the dead zone, of which the joint takes 5
    assert stepper.data.qfrc_actuator[0] + stepper.data.qfrc_applied[0] == pytest.approx(5.0)


def test_springs_of_attached_models_keep_their_unit(tmp_path):
    child = f"""<mujoco model="child"><compiler angle="radian"/><worldbody>{_link(0, 'name="elbow"', 'name="arm"')}
    </worldbody></mujoco>"""
    (tmp_path / "child.xml").write_text(child)
    (tmp_path / "model.xml").write_text(
        f"""<mujoco><compiler angle="degree"/><asset><model name="child" file="child.xml"/></asset>
        <worldbody>{_link(0, 'name="shoulder"')}<body pos="1 0 0"><attach model="child" body="arm" prefix="x_"/></body>
        </worldbody></mujoco>"""
    )
    spec = load_spec(tmp_path / "model.xml")
    ctx, spring = nominal_context(compile_variable(spec)), REGISTRY["joint_stiffness"]
    for joint in ("shoulder", "x_elbow"):
        out = spec.copy()
        out.compile()
        place = find_place(ctx, spring, joint)
        theta = spring.from_report(ctx, place, {"stiffness": 2.0, "reference": 0.5})
        assert spring.export(out, ctx, place, theta)
        for model in (out.compile(), mujoco.MjModel.from_xml_string(out.to_xml())):
            assert model.qpos_spring[place.index] == pytest.approx(0.5, rel=1e-5)


def test_drives_that_integrate_have_no_bias_before_their_limits():
    xml = f"""<mujoco><worldbody>{_link(0, 'name="arm"')}</worldbody><actuator>
    <intvelocity name="drift" joint="arm" kp="10" ctrlrange="-1 1" actrange="-6 6"/>
    <motor name="motor" joint="arm" ctrlrange="-1 1" ctrllimited="true"/></actuator></mujoco>"""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    assert [p.name for p in REGISTRY["actuator_bias:reclipped"].places(ctx)] == ["motor"]


def test_a_delay_begins_with_what_the_bias_before_it_makes_of_the_command():
    xml = f"""<mujoco><option gravity="0 0 0"/><worldbody>{_link(0, 'name="arm"')}</worldbody><actuator>
    <motor name="motor" joint="arm" ctrlrange="-1 1" ctrllimited="true"/></actuator></mujoco>"""
    bias = {"id": "actuator_bias", "form": "actuator_bias:reclipped", "at": "motor", "kind": "actuator"}
    entries = [
        {**bias, "parameters": {"bias": 0.3}},
        entry("actuator_delay", "motor", "actuator", delay=0.01),
    ]
    stepper = CorrectedModel.build(mujoco.MjSpec.from_string(xml), entries).c_stepper()
    stepper.reset(np.zeros(1), np.zeros(1))
    stepper.step(np.full(1, 0.2))
    assert stepper.data.actuator_force[0] == pytest.approx(0.5)


def test_units_follow_what_an_actuator_drives():
    xml = """<mujoco><worldbody><site name="wall" pos="1 0 0"/><body><joint name="x" type="slide" axis="1 0 0"/>
    <geom size=".1"/><site name="hook"/></body></worldbody>
    <tendon><spatial name="rope"><site site="wall"/><site site="hook"/></spatial></tendon>
    <actuator><motor name="motor" joint="x"/><motor name="winch" tendon="rope"/></actuator></mujoco>"""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    units = {
        (effect, p.name): [q.unit for q in REGISTRY[effect].params(ctx, p)]
        for effect in ("back_emf", "actuator_bias")
        for p in REGISTRY[effect].places(ctx)
    }
    assert units["back_emf", "motor"] == ["command s/m"]
    assert units["actuator_bias", "motor"] == units["actuator_bias", "winch"] == ["N"]


@pytest.mark.parametrize("name", ["a--b", "a---b", "-----"])
def test_any_name_may_stand_in_a_comment(name):
    text = with_comment('<mujoco model="m"><worldbody/></mujoco>', [f"cogging_torque at {name}"])
    assert "cogging_torque" in text
    ElementTree.fromstring(text)
    mujoco.MjModel.from_xml_string(text)


def test_a_timestep_of_nothing_is_refused():
    xml = f'<mujoco><option timestep="0"/><worldbody>{_link(0)}</worldbody></mujoco>'
    with pytest.raises(InputError, match="timestep is 0"):
        compile_variable(mujoco.MjSpec.from_string(xml))
