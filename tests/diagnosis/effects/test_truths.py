"""Effects against machines that are built otherwise, and settings of models that get in their way."""

from __future__ import annotations

import jax
import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording
from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.drives.drive_law import Log, predict
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.effects.step import Step
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.recordings.validation import validate
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.driving.measured_drives import follows
from mpge_jax.diagnosis.simulation.windows import Windows
from tests.diagnosis.machines import FINE_PENDULUM, entry

LINK = """<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5" contype="0" conaffinity="0"/>"""


def _exported(xml: str, *entries: dict[str, object]) -> tuple[mujoco.MjModel, mujoco.MjModel, list[bool]]:
    """The machine's model, the exported one after a round trip through XML, and which effects were native."""
    spec = load_spec(mujoco.MjSpec.from_string(xml))
    machine = CorrectedModel.build(spec, list(entries)).machine
    out = spec.copy()
    out.compile()
    native = [
        t.effect.export(out, machine.ctx, t.place, theta)
        for t, theta in zip(machine.terms, machine.thetas, strict=True)
    ]
    out.compile()
    return machine.model, mujoco.MjModel.from_xml_string(out.to_xml()), native


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
@pytest.mark.parametrize(
    ("kp", "kv", "limit", "armature", "stiffness"),
    [(100, 2, 0.8, 0.02, 5.0), (300, 25, 1e3, 0.02, 20.0), (4500, 450, 1e3, 0.1, 50.0)],
)
def test_a_spring_behind_a_servo_moves_like_two_bodies(integrator, kp, kv, limit, armature, stiffness):
    servo = f'kp="{kp}" kv="{kv}" forcerange="{-limit} {limit}" forcelimited="true"'
    option = f'<option timestep="0.002" integrator="{integrator}"/>'
    nominal = f"""<mujoco>{option}<worldbody><body name="arm"><joint name="hinge" axis="0 1 0" armature="{armature}"/>
    {LINK}</body></worldbody><actuator><position name="servo" joint="hinge" {servo}/></actuator></mujoco>"""
    fine = f'<option timestep="0.0001" integrator="{integrator}"/>'
    truth = f"""<mujoco>{fine}<worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>{LINK}</body>
    <body name="rotor"><joint name="motor" axis="0 1 0" armature="{armature}"/>
    <geom size=".001" mass="1e-6" contype="0" conaffinity="0"/></body></worldbody>
    <tendon><fixed name="spring" stiffness="{stiffness}" damping=".5" springlength="0"><joint joint="motor" coef="1"/>
    <joint joint="hinge" coef="-1"/></fixed></tendon><actuator><position joint="motor" {servo}/></actuator></mujoco>"""
    spring = entry("joint_flexibility", "hinge", "joint", stiffness=stiffness, damping=0.5)
    spec = mujoco.MjSpec.from_string(nominal)
    elastic, rigid = (CorrectedModel.build(spec, effects).c_stepper() for effects in ([spring], []))
    model = mujoco.MjModel.from_xml_string(truth)
    data, zero = mujoco.MjData(model), np.zeros(1)
    elastic.reset(zero, zero)
    rigid.reset(zero, zero)
    error, size = [], []
    for k in range(400):
        # the motor begins at rest
        target = np.array([0.0 if k < 20 else 0.4 if k < 200 else -0.2])
        elastic.step(target)
        rigid.step(target)
        data.ctrl[:] = target
        mujoco.mj_step(model, data, 20)
        error.append(elastic.data.qpos[0] - data.qpos[0])
        size.append(rigid.data.qpos[0] - data.qpos[0])
    error, size = (np.sqrt(np.mean(np.square(x))) for x in (error, size))
    assert error < 0.15 * size


def test_behind_a_spring_back_emf_slows_the_motor_and_not_the_link():
    """With it the machine is nearer to two bodies than with a spring, or a back-EMF, alone."""
    motor = '<general name="motor" joint="{}" gainprm="1" biastype="affine" biasprm="0 0 {}"/>'
    nominal = f"""<mujoco><option timestep="0.002"/><worldbody><body name="arm">
    <joint name="hinge" axis="0 1 0" armature="0.02"/>{LINK}</body></worldbody>
    <actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
    truth = f"""<mujoco><option timestep="0.0001"/><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>{LINK}
    </body><body name="rotor"><joint name="shaft" axis="0 1 0" armature="0.02"/>
    <geom size=".001" mass="1e-6" contype="0" conaffinity="0"/></body></worldbody>
    <tendon><fixed name="spring" stiffness="5" damping=".1" springlength="0"><joint joint="shaft" coef="1"/>
    <joint joint="hinge" coef="-1"/></fixed></tendon><actuator>{motor.format("shaft", -0.6)}</actuator></mujoco>"""
    spring = entry("joint_flexibility", "hinge", "joint", stiffness=5.0, damping=0.1)
    braked = entry("back_emf", "motor", "actuator", coefficient=0.6)
    model = mujoco.MjModel.from_xml_string(truth)
    data = mujoco.MjData(model)
    steppers = [
        CorrectedModel.build(mujoco.MjSpec.from_string(nominal), entries).c_stepper()
        for entries in ([spring, braked], [spring], [braked])
    ]
    for stepper in steppers:
        stepper.reset(np.zeros(1), np.zeros(1))
    errors = []
    for k in range(400):
        u = np.array([1.5 * np.sign(np.sin(0.06 * k)) if k > 5 else 0.0])
        data.ctrl[:] = u
        mujoco.mj_step(model, data, 20)
        for stepper in steppers:
            stepper.step(u)
        errors.append([stepper.data.qpos[0] - data.qpos[0] for stepper in steppers])
    both, spring_only, braked_only = np.sqrt(np.mean(np.square(errors), axis=0))
    assert both < 0.15 * min(spring_only, braked_only)


def test_behind_a_servo_the_motor_rests_where_spring_or_gap_and_servo_agree():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(FINE_PENDULUM)))
    place, one = Place("joint", "hinge", 0), np.ones(1)
    # the servo gives 3 N m at the link's angle and 30 N m / rad less as the motor turns on
    s = Step(
        np.full(1, 0.2), 0 * one, one[None], 3 * one[None], 3 * one[None], -1e9 * one[None], 1e9 * one[None],
        -30 * one[None], 0 * one[None], lambda _b: None, 0.002,
    )  # fmt: skip
    s.q, s.v = s.q[None], s.v[None]
    spring, gap = REGISTRY["joint_flexibility"], REGISTRY["backlash"]
    angle, _ = spring.memory(np, ctx, place, np.array([[20.0, 0.1]]), s)
    np.testing.assert_allclose(angle - 0.2, 3.0 / (20.0 + 30.0))
    angle, *_ = gap.memory(np, ctx, place, np.array([[1.0, 0.2]]), s)
    np.testing.assert_allclose(angle - 0.2, 3.0 / 30.0)
    angle, *_ = gap.memory(np, ctx, place, np.array([[0.02, 0.2]]), s)
    np.testing.assert_allclose(angle - 0.2, 0.01)


def test_armature_of_the_actuator_is_the_motors_inertia_too():
    xml = f"""<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>{LINK}</body></worldbody>
    <actuator><motor name="motor" joint="hinge" gear="10" armature="2e-4"/></actuator></mujoco>"""
    model = compile_variable(mujoco.MjSpec.from_string(xml))
    assert [p.name for p in REGISTRY["backlash"].places(nominal_context(model))] == ["hinge"]
    machine = CorrectedModel.build(
        mujoco.MjSpec.from_string(xml), [entry("backlash", "hinge", "joint", gap=0.1)]
    )
    inertia = []
    for m in (model, machine.machine.model):
        data, full = mujoco.MjData(m), np.zeros((1, 1))
        mujoco.mj_forward(m, data)
        mujoco.mj_fullM(m, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(m, data, full)
        inertia.append(full[0, 0])
    assert inertia[0] - inertia[1] == pytest.approx(2e-4 * 100)


@pytest.mark.parametrize(
    ("effect", "parameter"), [("actuator_delay", "delay"), ("actuator_lag", "time_constant")]
)
def test_late_commands_have_moved_filters_before_a_window_begins(effect, parameter):
    xml = f"""<mujoco><option timestep="0.002"/><worldbody><body name="arm">
    <joint name="hinge" axis="0 1 0" armature=".004" damping=".05"/>{LINK}</body></worldbody>
    <actuator><general name="motor" joint="hinge" dyntype="filterexact" dynprm=".1"/></actuator></mujoco>"""
    late = entry(effect, "motor", "actuator", **{parameter: 0.03})
    stepper, recordings = CorrectedModel.build(mujoco.MjSpec.from_string(xml), [late]).c_stepper(), []
    for k in range(3):
        stepper.reset(np.array([0.1 * k]), np.zeros(1))
        rows = []
        for t in 0.01 * np.arange(400):
            u = np.array([np.sin(7 * t + k) + 0.5 * np.sign(np.sin(11 * t))])
            rows.append((stepper.data.qpos.copy(), stepper.data.qvel.copy(), u))
            stepper.step(u, 5)
        q, v, u = (np.array(x) for x in zip(*rows, strict=True))
        recordings.append(Recording(f"run_{k}", 0.01 * np.arange(400), q, v, u))
    spec = mujoco.MjSpec.from_string(xml)
    plain = compile_variable(spec)
    p = prepare(spec, [validate(r, plain, names_of(plain)) for r in recordings], Config(jobs=1))
    w = p.windows("train", 0.25, 30)
    term = Term(effect, Place("actuator", "motor", 0))
    runs = [Run(Hypothesis.of(term), np.array([T])) for T in (0.03, 0.045, 0.015)] + [
        Run(Hypothesis(), np.zeros(0))
    ]
    right, longer, shorter, nominal = np.sqrt(np.nanmean(p.sim.residuals(runs, w)[..., 0] ** 2, axis=(1, 2)))
    assert right < 0.25 * min(longer, shorter) and right < 0.15 * nominal


def test_a_sensor_may_be_late_and_off():
    entries = [
        entry("encoder_offset", "hinge", "joint", offset=0.3),
        entry("sensor_delay", "hinge", "joint", delay=0.01),
    ]
    corrected = CorrectedModel.build(mujoco.MjSpec.from_string(FINE_PENDULUM), entries)
    stepper, engine = corrected.c_stepper(), corrected.jax_engine()
    stepper.reset(np.array([0.5]), np.zeros(1))
    past, speeds = [], []
    data = jax.jit(engine.init)(np.array([0.5]), np.zeros(1))
    step = jax.jit(engine.step, static_argnums=2)
    for _ in range(20):
        past.append(float(stepper.data.qpos[0]))
        speeds.append(float(stepper.data.qvel[0]))
        stepper.step(np.array([0.2]))
        data = step(data, np.array([0.2]), 1)
    assert stepper.measured()[0] == pytest.approx(past[-5] + 0.3, abs=1e-9)
    assert float(data.qpos[0]) == pytest.approx(stepper.measured()[0], abs=1e-4)
    assert stepper.measured_speed()[0] == pytest.approx(speeds[-5], abs=1e-9) != stepper.data.qvel[0]
    assert float(data.qvel[0]) == pytest.approx(speeds[-5], abs=1e-3)


def test_delays_are_exported_as_fine_as_they_were_fitted():
    late = entry("actuator_delay", "motor", "actuator", delay=0.0051)
    corrected = CorrectedModel.build(mujoco.MjSpec.from_string(FINE_PENDULUM), [late]).c_stepper()
    _, model, native = _exported(FINE_PENDULUM, late)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    corrected.reset(np.zeros(1), np.zeros(1))
    assert native == [True]
    for k in range(100):
        u = rng.uniform(-1, 1, 1) * (k > 5)
        corrected.step(u)
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
        assert data.qpos[0] == pytest.approx(corrected.data.qpos[0], abs=1e-9)


def test_lags_shorter_than_a_step_are_not_native_and_keyframes_keep_their_activations():
    xml = f"""<mujoco><option timestep="0.01"/><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>
    {LINK}</body></worldbody><actuator><motor name="a" joint="hinge"/>
    <general name="b" joint="hinge" dyntype="filterexact" dynprm=".1"/></actuator>
    <keyframe><key name="home" qpos=".2" act=".3" ctrl=".5 .7"/></keyframe></mujoco>"""
    _, model, native = _exported(xml, entry("actuator_lag", "a", "actuator", time_constant=0.005))
    assert native == [False] and model.na == 1
    _, model, native = _exported(xml, entry("actuator_lag", "a", "actuator", time_constant=0.05))
    assert native == [True]
    np.testing.assert_allclose(model.key_act[0], [0.5, 0.3])
    more = xml.replace(
        '<motor name="a" joint="hinge"/>', '<motor name="a" joint="hinge"/><motor name="c" joint="hinge"/>'
    )
    more = more.replace('ctrl=".5 .7"', 'ctrl=".5 .6 .7"')
    lags = [entry("actuator_lag", at, "actuator", time_constant=0.05) for at in "ac"]
    np.testing.assert_allclose(_exported(more, *lags)[1].key_act[0], [0.5, 0.6, 0.3])
    plain = more.replace('dyntype="filterexact" dynprm=".1"', "").replace('act=".3"', "")
    np.testing.assert_allclose(_exported(plain, *lags)[1].key_act[0], [0.5, 0.6])


def _inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    r = np.zeros(9)
    mujoco.mju_quat2Mat(r, model.body_iquat[body])
    r = r.reshape(3, 3)
    return r @ np.diag(model.body_inertia[body]) @ r.T


def test_turned_inertials_are_written_as_they_are():
    xml = """<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>
    <inertial pos="0 0 -.1" mass="1" diaginertia=".01 .02 .025" euler="0 30 0"/><geom size=".1"/></body></worldbody>
    <actuator><motor joint="hinge"/></actuator></mujoco>"""
    machine, exported, _ = _exported(
        xml, entry("payload_mass", "arm", "body", mass=0.5, position=[0.1, 0.05, -0.3])
    )
    np.testing.assert_allclose(_inertia(exported, 1), _inertia(machine, 1), atol=1e-6)


def test_what_the_compiler_derives_from_masses_is_written_as_numbers():
    xml = f"""<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0" springdamper=".2 1"/>{LINK}
    <site name="end" pos="0 0 -.3"/></body><body name="other" pos="1 0 0"><joint name="far" axis="0 1 0" ref="20"/>
    {LINK}</body></worldbody><tendon><fixed name="t"><joint joint="far" coef="1"/></fixed></tendon>
    <actuator><muscle name="muscle" joint="far" lengthrange="0 1"/><motor name="m" joint="hinge"/></actuator>
    </mujoco>"""
    nominal = compile_variable(mujoco.MjSpec.from_string(xml))
    machine, exported, native = _exported(
        xml,
        entry("viscous_damping", "hinge", "joint", coefficient=0.3),
        entry("joint_stiffness", "far", "joint", stiffness=0.7, reference=0.5),
        entry("mass_scale", "world", "world", factor=1.5),
    )
    assert all(native)
    assert nominal.actuator_gainprm[0, 2] > 0 and nominal.actuator_biasprm[0, 2] > 0
    for m in (machine, exported):
        assert m.dof_damping[0] == pytest.approx(nominal.dof_damping[0] + 0.3, rel=1e-5)
        assert m.jnt_stiffness[0] == pytest.approx(nominal.jnt_stiffness[0], rel=1e-5)
        np.testing.assert_allclose(m.actuator_gainprm[0], nominal.actuator_gainprm[0], rtol=1e-5)
        np.testing.assert_allclose(m.tendon_lengthspring, nominal.tendon_lengthspring, rtol=1e-5, atol=1e-9)


def test_a_joints_limit_on_its_motor_comes_after_the_dead_zone():
    xml = f"""<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0" actuatorfrcrange="-5 5"/>
    {LINK}</body></worldbody><actuator><motor name="motor" joint="hinge" gear="-2"/></actuator></mujoco>"""
    stepper = CorrectedModel.build(
        mujoco.MjSpec.from_string(xml), [entry("actuator_deadzone", "motor", "actuator", width=0.5)]
    ).c_stepper()
    stepper.reset(np.zeros(1), np.zeros(1))
    for command, torque in ((5.0, -5.0), (1.0, -1.0), (-10.0, 5.0)):
        stepper.step(np.array([command]))
        total = stepper.data.qfrc_actuator[0] + stepper.data.qfrc_applied[0]
        assert total == pytest.approx(torque)


@pytest.mark.parametrize(
    "beside",
    ['<motor tendon="t"/>', "compensated"],
)
def test_a_joints_limit_on_more_than_its_motor_stays_the_joints(beside):
    """It clips the sum with tendons' forces and with the compensation of gravity."""
    gravity = ' actuatorgravcomp="true"' if beside == "compensated" else ""
    xml = f"""<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0" actuatorfrcrange="-5 5"{gravity}/>
    {LINK}</body></worldbody><tendon><fixed name="t"><joint joint="hinge" coef="1"/></fixed></tendon><actuator>
    <motor name="motor" joint="hinge"/>{"" if gravity else beside}</actuator></mujoco>"""
    assert not load_spec(mujoco.MjSpec.from_string(xml)).compile().actuator_forcelimited.any()


def test_a_dead_zone_of_a_tendons_motor_comes_after_its_limits_or_before():
    xml = f"""<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>{LINK}</body></worldbody>
    <tendon><fixed name="t"><joint joint="hinge" coef="1"/></fixed></tendon><actuator>
    <motor name="motor" tendon="t" forcerange="-5 5" forcelimited="true"/></actuator></mujoco>"""
    effects = [
        entry("actuator_deadzone", "motor", "actuator", width=1.0),
        entry("actuator_gain", "motor", "actuator", gain=0.5),
    ]
    before = [{**effects[0], "form": "actuator_deadzone:limited"}]
    for known, command, force in (
        (effects[:1], 5.5, 4.0), (effects[:1], -9.0, -4.0), (effects, 6.0, 1.5), (before, 5.5, 4.5), (before, 9.0, 5.0)
    ):  # fmt: skip
        stepper = CorrectedModel.build(mujoco.MjSpec.from_string(xml), known).c_stepper()
        stepper.reset(np.zeros(1), np.zeros(1))
        stepper.step(np.array([command]))
        assert stepper.data.actuator_force[0] == pytest.approx(force)


GRAVITY_FREE = f"""<mujoco><worldbody><body name="arm" gravcomp="1"><joint name="hinge" axis="0 1 0"/>{LINK}
<body name="tip" pos="0 0 -.3" gravcomp="1"><geom size=".02" mass=".1" contype="0" conaffinity="0"/></body></body>
</worldbody><actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("heavier", "moment"),
    [
        (entry("mass_scale", "world", "world", factor=1.5), 0.5 * (0.5 * 0.15 + 0.1 * 0.3)),
        (
            {"form": "given_inertias:0.03"}
            | entry("given_inertias", "world", "world", mass=[1.06, 0.97], inertia=[1.0, 1.0]),
            0.06 * 0.5 * 0.15 - 0.03 * 0.1 * 0.3,
        ),
    ],
)
def test_compensated_gravity_is_that_of_the_known_masses(heavier, moment):
    machine, exported, _ = _exported(GRAVITY_FREE, heavier)
    for m in (machine, exported):
        data = mujoco.MjData(m)
        data.qpos[:] = 0.5
        mujoco.mj_forward(m, data)
        bias = data.qfrc_bias[0] - data.qfrc_passive[0]
        assert bias == pytest.approx(9.81 * np.sin(0.5) * moment, rel=1e-3)


def test_gravity_is_not_changed_where_the_engine_compensates_it():
    """It does so with the gravity that there is, at the centre of mass wherever that moves."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(GRAVITY_FREE)))
    for effect in ("gravity_tilt", "payload_mass", "com_offset"):
        assert not REGISTRY[effect].places(ctx)
    assert {p.kind for p in REGISTRY["external_force"].places(ctx)} == {"body"}


@pytest.mark.parametrize("scale", [1.0, 1.5])
def test_a_force_on_the_whole_machine_is_that_force_whatever_the_masses(scale):
    xml = f"""<mujoco><option gravity="0 0 0"/><worldbody><body name="a"><joint name="x" type="slide" axis="1 0 0"/>
    {LINK}<body name="b"><joint name="y" axis="0 1 0"/>{LINK}</body></body></worldbody>
    <actuator><motor joint="x"/></actuator></mujoco>"""
    machine, exported, _ = _exported(
        xml,
        entry("external_force", "world", "world", force=[4.0, 0.0, 0.0]),
        entry("mass_scale", "world", "world", factor=scale),
    )
    for m in (machine, exported):
        data = mujoco.MjData(m)
        mujoco.mj_forward(m, data)
        assert -data.qfrc_bias[0] == pytest.approx(4.0, rel=1e-5)


def test_the_force_of_a_damper_follows_the_motion():
    xml = f"""<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>{LINK}</body></worldbody><actuator>
    <damper joint="hinge" kv="1" ctrlrange="0 1"/><motor joint="hinge"/></actuator></mujoco>"""
    assert follows(mujoco.MjModel.from_xml_string(xml)).tolist() == [True, False]


@pytest.mark.parametrize(
    ("form", "forces"),
    [("actuator_deadzone", [0.0, 2.0, 4.0, 4.0]), ("actuator_deadzone:limited", [0.0, 2.0, 4.5, 5.0])],
)
def test_measured_forces_of_a_tendons_motor_show_where_its_dead_zone_is(form, forces):
    xml = f"""<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>{LINK}</body></worldbody>
    <tendon><fixed name="t"><joint joint="hinge" coef="1"/></fixed></tendon><actuator>
    <motor name="motor" tendon="t" forcerange="-5 5" forcelimited="true"/></actuator></mujoco>"""
    model = compile_variable(mujoco.MjSpec.from_string(xml))
    term, width = Term(form, Place("actuator", "motor", 0)), np.ones(1)
    u, zero = np.array([0.5, 3.0, 5.5, 9.0]), np.zeros(4)
    log = Log("run", zero, u[None], np.arange(4), zero, zero, zero, np.arange(4))
    force = predict(model, nominal_context(model), Fitted(Hypothesis.of(term), width, width), 0, log, 0.002)
    np.testing.assert_allclose(force, forces)


def test_commands_of_integrators_are_left_alone():
    xml = f"""<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>{LINK}</body></worldbody><actuator>
    <intvelocity joint="hinge" kp="10" actrange="-1 1"/><motor name="motor" joint="hinge"/></actuator></mujoco>"""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    for effect in ("actuator_delay", "actuator_lag"):
        assert [p.name for p in REGISTRY[effect].places(ctx)] == ["motor"]


@pytest.mark.parametrize(
    ("effect", "at", "values"),
    [
        ("backlash", "hinge", {"gap": 0.2}),
        ("joint_flexibility", "hinge", {"stiffness": 40.0, "damping": 0.1}),
        ("load_dependent_friction", "hinge", {"coulomb": 0.0, "load_coefficient": 0.5}),
    ],
)
def test_what_a_dead_zone_swallows_reaches_no_gear(effect, at, values):
    """A motor's force of 0.25 N m, all within the dead zone, leaves the arm as no command does."""
    xml = f"""<mujoco><option gravity="0 0 0"/><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"
    armature="0.01"/>{LINK}</body></worldbody><actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
    known = [
        entry("actuator_deadzone", "motor", "actuator", width=0.3),
        entry(effect, at, "joint", **values),
    ]
    motion = []
    for command in (0.25, 0.0):
        stepper = CorrectedModel.build(mujoco.MjSpec.from_string(xml), known).c_stepper()
        stepper.reset(np.zeros(1), np.full(1, 0.5))
        for _ in range(50):
            stepper.step(np.array([command]))
        motion.append([stepper.data.qpos[0], stepper.data.qvel[0]])
    np.testing.assert_allclose(motion[0], motion[1], atol=1e-9)


@pytest.mark.parametrize(
    ("effect", "values"),
    [("backlash", {"gap": 0.05}), ("joint_flexibility", {"stiffness": 40.0, "damping": 0.4})],
)
def test_a_dead_zone_takes_from_a_drive_at_its_limit_too(effect, values):
    """A motor of at most 5 N m, less 1 N m, holds a spring of 10 N m/rad 0.4 rad away, behind a gear or not."""
    xml = f"""<mujoco><option gravity="0 0 0"/><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"
    armature="0.01" damping="2" stiffness="10"/>{LINK}</body></worldbody><actuator>
    <motor name="motor" joint="hinge" forcerange="-5 5"/></actuator></mujoco>"""
    known = [
        entry("actuator_deadzone", "motor", "actuator", width=1.0),
        entry(effect, "hinge", "joint", **values),
    ]
    stepper = CorrectedModel.build(mujoco.MjSpec.from_string(xml), known).c_stepper()
    stepper.reset(np.full(1, 0.4), np.zeros(1))
    for _ in range(2000):
        stepper.step(np.array([9.0]))
    assert stepper.data.qpos[0] == pytest.approx(0.4, abs=0.005)


def test_limits_that_meet_can_be_written():
    xml = f"""<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>{LINK}</body></worldbody>
    <actuator><motor name="motor" joint="hinge" forcerange="-0.5 0.5"/></actuator></mujoco>"""
    known = [
        entry("actuator_bias", "motor", "actuator", bias=0.7),
        entry("torque_saturation", "motor", "actuator", limit=0.1),
    ]
    _, model, native = _exported(xml, *known)
    assert all(native)
    np.testing.assert_allclose(model.actuator_forcerange[0], 0.1, rtol=2e-3)


@pytest.mark.parametrize(("effect", "theta"), [("backlash", [0.1, 0.2]), ("joint_flexibility", [3.0, 0.02])])
def test_the_motors_past_knows_the_dead_zone(effect, theta):
    """Before a window, too, 0.25 N m within a dead zone of 0.3 N m do nothing behind the gear."""
    xml = f"""<mujoco><option gravity="0 0 0"/><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"
    armature="0.01"/>{LINK}</body></worldbody><actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
    model = compile_variable(mujoco.MjSpec.from_string(xml))
    ctx, dt, steps, history = nominal_context(model), float(model.opt.timestep), 40, 300
    time = dt * np.arange(600)
    q, v = 0.3 * np.sin(4 * time)[:, None], 1.2 * np.cos(4 * time)[:, None]
    states = States(q, v, 0 * q, np.zeros((600, 1, 2, 2)))
    gear = Term(effect, Place("joint", "hinge", 0))
    zone = Term("actuator_deadzone", Place("actuator", "motor", 0))
    parts = {gear: np.array(theta), zone: np.array([0.3])}
    got = {}
    for terms in ((gear,), (gear, zone)):
        h = Hypothesis.of(*terms)
        for force in (0.0, 0.25):
            u = np.full((600, 1), force)
            source = Source.build(Recording("r", time, q, None, u), states, u)
            w = Windows(
                (source,), np.zeros(1, int), time[400:401], dt, steps, q[400:401], v[400:401], np.zeros((1, 1, 2, 2)),
                np.zeros((1, 0)), np.full((1, history + steps, 1), force), dt * np.arange(1, steps + 1)[None],
                np.ones((1, steps), bool), q[None, 401 : 401 + steps], np.full((1, steps, 1), np.nan),
                np.zeros((1, 1, 2)), np.zeros((1, steps), bool), *np.zeros((2, 1, steps, 1)),
            )  # fmt: skip
            run = Run(h, h.gather(ctx, parts))
            got[len(terms), force] = Simulator(model, ctx).residuals([run], w)[0, 0, :, 0]
    assert np.abs(got[1, 0.0] - got[1, 0.25]).max() > 1e-3
    np.testing.assert_allclose(got[2, 0.25], got[2, 0.0], atol=1e-9)
