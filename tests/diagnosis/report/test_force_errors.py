"""Recordings of motion and force without commands: the force is predicted, and errors are in its units."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY, Config, InputError, Recording, diagnose
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.effects.base import find_place
from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.recordings.recording import validate
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.report import force_errors
from mpge_jax.diagnosis.simulation.drive_signal import Source
from mpge_jax.diagnosis.simulation.single_step import Machine
from mpge_jax.diagnosis.verdict.location import locate
from tests.diagnosis.machines import ARM, PENDULUM, excitation, record

GEAR = 20.0
GEARED = PENDULUM.replace('joint="hinge" ctrl', f'joint="hinge" gear="{GEAR}" ctrl')
LEVER = 0.5 * 9.81 * 0.15
"""Torque (N m) of the pendulum's weight when it lies level."""
ROTORS = """<mujoco><worldbody><body name="drone"><joint name="x" type="slide" axis="1 0 0"/>
<joint name="z" type="slide" axis="0 0 1"/><joint name="pitch" axis="0 1 0"/>
<geom type="box" size=".2 .05 .02" mass="0.8"/><site name="left" pos="-.2 0 0"/><site name="right" pos=".2 0 0"/></body>
</worldbody><actuator><motor name="left" site="left" gear="0 0 1 0 0 0"/>
<motor name="right" site="right" gear="0 0 1 0 0 0"/></actuator></mujoco>"""


def _source(qpos, qvel, qacc):
    qpos, qvel, qacc = (np.atleast_2d(np.asarray(x, float).T).T for x in (qpos, qvel, qacc))
    rows = len(qpos)
    recording = Recording("r", 0.01 * np.arange(rows), qpos)
    states = States(qpos, qvel, qacc, np.zeros((rows, qvel.shape[1], 2, 2)))
    return Source.build(recording, states, np.zeros((rows, 1)))


def _machine(xml, parts=()):
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    terms = tuple(Term(i, find_place(ctx, REGISTRY[i], at)) for i, at, _ in parts)
    return Machine.build(ctx, terms, tuple(np.array(theta) for _, _, theta in parts))


def _needed(machine, *states):
    return force_errors._needed(machine, _source(*states), slice(1, len(states[0])))


def test_force_is_that_of_gravity_and_inertia_before_the_gear():
    q = np.array([0.0, 0.3, -0.7])
    still = _needed(_machine(GEARED), q, 0 * q, 0 * q)
    # a positive angle about y swings the rod to -x; gravity pulls it back
    np.testing.assert_allclose(still[:, 0], LEVER * np.sin(q[1:]) / GEAR, rtol=1e-6)
    model = _machine(GEARED).model
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0], data.qacc[0] = 0.3, 2.0, 5.0
    mujoco.mj_inverse(model, data)
    moving = _needed(_machine(GEARED), [0.3, 0.3], [2.0, 2.0], [5.0, 5.0])
    assert moving[0, 0] == pytest.approx(data.qfrc_inverse[0] / GEAR)


@pytest.mark.parametrize("speed", [2.0, -2.0])
def test_friction_adds_to_the_force(speed):
    states = ([0.3] * 8, [speed] * 8, [0.0] * 8)
    plain = GEAR * _needed(_machine(GEARED), *states)[-1, 0]
    sign = np.sign(speed)
    dry = _needed(_machine(GEARED, [("coulomb_friction", "hinge", [0.1])]), *states)
    assert GEAR * dry[-1, 0] - plain == pytest.approx(0.1 * sign, rel=1e-2)
    drag = _needed(_machine(GEARED, [("quadratic_drag", "hinge", [0.05])]), *states)
    assert GEAR * drag[-1, 0] - plain == pytest.approx(0.05 * 4.0 * sign)
    # torque = plain + (0.02 + 0.2 |torque|) sgn v, solved for the torque
    load = _needed(_machine(GEARED, [("load_dependent_friction", "hinge", [0.02, 0.2])]), *states)
    lifts = np.sign(plain + 0.02 * sign) * sign
    assert GEAR * load[-1, 0] == pytest.approx((plain + 0.02 * sign) / (1 - 0.2 * lifts), rel=2e-2)


def test_forces_at_sites_and_outside_forces():
    flat = np.zeros((3, 3))
    hover = _needed(_machine(ROTORS), flat, flat, flat)
    np.testing.assert_allclose(hover, 0.5 * 0.8 * 9.81, rtol=1e-6)
    lifted = _machine(ROTORS, [("external_force", "drone", [0.0, 0.0, 1.0])])
    np.testing.assert_allclose(_needed(lifted, flat, flat, flat), 0.5 * (0.8 * 9.81 - 1.0), rtol=1e-6)


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


def _located(*terms, joints, rivals=(), actuators=None):
    model = compile_variable(mujoco.MjSpec.from_string(ARM))
    ctx = nominal_context(model)
    term = [Term(i, find_place(ctx, REGISTRY[i], at)) for i, at in terms]
    tied = [Term(i, find_place(ctx, REGISTRY[i], at)) for i, at in rivals]

    def fit(*x):
        return SimpleNamespace(hypothesis=Hypothesis.of(*x))

    return locate(
        SimpleNamespace(
            prepared=SimpleNamespace(model=model, names=names_of(model), train_sources=()),
            terms=tuple(term),
            fit=fit(*term),
            rivals={term[0]: [SimpleNamespace(tied=True, fit=fit(t)) for t in tied]} if tied else {},
            location=[(name, "joint", ratio) for name, ratio in joints],
            actuators=actuators,
            unexplained=None,
        )
    )


def test_bodies_actuators_and_the_world_are_located_by_the_joints_on_which_they_act():
    joints = [("elbow", 40.0), ("shoulder", 9.0)]
    assert _located(("coulomb_friction", "elbow"), joints=joints) == [
        ("elbow", "joint", 40.0),
        ("shoulder", "joint", 9.0),
    ]
    assert _located(("actuator_gain", "shoulder_motor"), joints=joints) == [
        ("elbow", "joint", 40.0),
        ("shoulder_motor", "actuator", 9.0),
        ("shoulder", "joint", 9.0),
    ]
    assert _located(("payload_mass", "fore"), joints=joints)[0] == ("fore", "body", 40.0)
    assert _located(("payload_mass", "upper"), joints=joints)[1] == ("upper", "body", 9.0)
    assert _located(("mass_scale", "world"), joints=joints)[0] == ("world", "world", 40.0)
    both = _located(("coulomb_friction", "elbow"), joints=joints, rivals=[("actuator_gain", "elbow_servo")])
    assert both[:2] == [("elbow", "joint", 40.0), ("elbow_servo", "actuator", 40.0)]
    drives = SimpleNamespace(excess={"elbow_servo": 36.0, "shoulder_motor": 1.0})
    located = _located(joints=joints, actuators=drives)
    assert located[1] == ("elbow_servo", "actuator", pytest.approx(36.0))
    assert located[-1] == ("shoulder_motor", "actuator", pytest.approx(1.0))


def test_a_geom_goes_by_its_body():
    names = names_of(compile_variable(mujoco.MjSpec.from_string(ARM)))
    model = compile_variable(mujoco.MjSpec.from_string(ARM))
    term = Term("contact_friction", Place("geom", names.geoms[1], 1))
    d = SimpleNamespace(
        prepared=SimpleNamespace(model=model, names=names, train_sources=()),
        terms=(term,),
        fit=None,
        rivals={},
        location=[("elbow", "joint", 3.0)],
        actuators=None,
        unexplained=None,
    )
    assert locate(d) == [("fore", "body", 3.0), ("elbow", "joint", 3.0)]


def test_a_floating_base_is_located_by_its_body():
    """Wind on the base of a planar drone with an arm: the base misses force, and so does what hangs on it."""
    arm = '<body name="arm"><joint name="swing" axis="0 1 0" damping=".02"/>'
    arm += '<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".2"/></body></body>'
    xml = ROTORS.replace("</body>", arm).replace("<worldbody>", '<option gravity="0 0 0"/><worldbody>')

    def wind(_model, data):
        data.xfrc_applied[1, 0] = 0.5

    recordings = record(xml, 0.05, force=wind, count=3, seconds=1.5)
    prepared = prepare(mujoco.MjSpec.from_string(xml), recordings, Config(jobs=1))
    term = Term("external_force", Place("body", "drone", 1))
    fit = SimpleNamespace(hypothesis=Hypothesis.of(term))
    d = SimpleNamespace(
        prepared=prepared,
        terms=(term,),
        fit=fit,
        rivals={},
        actuators=None,
        unexplained=None,
        location=[("swing", "joint", 1.5)],
    )
    (name, kind, ratio), *others = locate(d)
    assert (name, kind) == ("drone", "body") and ratio > 10.0
    assert others == [("swing", "joint", 1.5)]
