"""What the table says of pairs of effects is true of their motions."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.candidates import all_terms
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.evidence.same_in_principle import TABLE, same
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from tests.diagnosis.machines import ARM, PENDULUM, record
from tests.diagnosis.searches import prepared_of

BARE = PENDULUM.replace('damping="0.02" armature="0.004"', "")
DOUBLE = ARM.replace(
    '<position name="elbow_servo" joint="elbow" kp="8" kv="0.4"/>',
    '<motor name="elbow_motor" joint="elbow"/>',
)
TABLE_XY = """<mujoco><option timestep="0.002"/><worldbody><body name="bridge"><joint name="x" type="slide" axis="1 0 0"
damping="2"/><geom size="0.1" mass="2"/><body name="head"><joint name="y" type="slide" axis="0 1 0" damping="1"/>
<geom size="0.05" mass="0.5"/></body></body></worldbody><actuator><motor name="x_drive" joint="x" gear="3"/>
<motor name="y_drive" joint="y"/></actuator></mujoco>"""
WITH_A_PENDULUM = TABLE_XY.replace(
    '<geom size="0.05" mass="0.5"/>',
    '<geom size="0.05" mass="0.5"/><body><joint name="swing" axis="0 1 0"/><geom pos="0 0 -.2" size="0.05"/></body>',
)
RATIO, DELAY, TILT, COEFFICIENT, PUSH = 0.3, 0.02, 0.1, 0.05, 1.5


def terms_of(xml: str) -> dict[str, Term]:
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    # the first place of each: the root's joint, its motor and body
    return {t.id: t for t in reversed(all_terms(ctx, None))}


def percussion() -> list[float]:
    """A mass on the pendulum that lets inertia and weight grow by one ratio: mass, and where it sits."""
    m = mujoco.MjModel.from_xml_string(BARE)
    weight = float(m.body_mass[1] * -m.body_ipos[1, 2])
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)
    inertia = float(data.qM[0]) if hasattr(data, "qM") else float(data.M[0])
    length = inertia / weight
    return [RATIO * weight / length, 0.0, 0.0, -length]


def turns(angle: float) -> list[list[float]]:
    """The two components across gravity of turns of the base about level axes, of which one is meant."""
    return [[angle, 0.0], [-angle, 0.0], [0.0, angle], [0.0, -angle]]


LEANING = float(np.arcsin(PUSH / (2.5 * 9.81)))
"""Turn of the base by which the weight of the xy-table's bridge and head pushes along x."""
CASES = {
    ("actuator_delay", "sensor_delay"): (PENDULUM, [DELAY], [DELAY], 0.1),
    ("gravity_tilt", "encoder_offset"): (DOUBLE, turns(TILT), [TILT], 1e-6),
    ("viscous_damping", "back_emf"): (PENDULUM, [COEFFICIENT], [COEFFICIENT], 1e-6),
    ("payload_mass", "actuator_gain"): (BARE, percussion(), [1 / (1 + RATIO)], 1e-6),
    ("mass_scale", "actuator_gain"): (BARE, [1 + RATIO], [1 / (1 + RATIO)], 1e-6),
    ("actuator_bias", "external_force"): (TABLE_XY, [PUSH / 3], [PUSH, 0.0, 0.0], 1e-6),
    ("gravity_tilt", "actuator_bias"): (TABLE_XY, turns(LEANING), [PUSH / 3], 1e-6),
    ("gravity_tilt", "external_force"): (TABLE_XY, turns(LEANING), [PUSH, 0.0, 0.0], 1e-6),
}


def test_every_pair_is_tried():
    assert set(CASES) == set(TABLE)


@pytest.mark.parametrize("pair", CASES, ids=" and ".join)
def test_effects_that_are_the_same_move_the_machine_alike(pair):
    xml, one, other, tolerance = CASES[pair]
    known = terms_of(xml)
    a, b = (known[name] for name in pair)
    p = prepared_of(xml, record(xml, 0.5, noise=1e-7))
    assert same(p.ctx, a, b) and same(p.ctx, b, a)
    w = p.windows("train", 0.5, 4)
    runs = [Run(Hypothesis(), np.zeros(0)), Run(Hypothesis.of(b), np.array(other))]
    runs += [Run(Hypothesis.of(a), np.array(x)) for x in (one if isinstance(one[0], list) else [one])]
    plain, second, *first = p.sim.residuals(runs, w)[..., : p.model.nv]
    effect = np.sqrt(np.nanmean((second - plain) ** 2))
    apart = min(np.sqrt(np.nanmean((x - second) ** 2)) for x in first)
    assert effect > 1e-3 and apart < tolerance * effect


@pytest.mark.parametrize(
    ("pair", "xml"),
    [
        # the elbow's motion tells the shoulder's encoder from its motor
        (("actuator_delay", "sensor_delay"), DOUBLE),
        (
            ("gravity_tilt", "encoder_offset"),
            DOUBLE.replace('name="elbow" axis="0 1 0"', 'name="elbow" axis="1 0 0"'),
        ),
        (("payload_mass", "actuator_gain"), DOUBLE),
        (("mass_scale", "actuator_gain"), DOUBLE),
        (("viscous_damping", "coulomb_friction"), PENDULUM),
        # a motor's constant torque turns with its joint, a force does not
        (("actuator_bias", "external_force"), PENDULUM),
        # what hangs from it swings out
        (("gravity_tilt", "actuator_bias"), WITH_A_PENDULUM),
        (("gravity_tilt", "external_force"), WITH_A_PENDULUM),
    ],
)
def test_elsewhere_the_data_decide(pair, xml):
    known = terms_of(xml)
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    assert not same(ctx, *(known[name] for name in pair))


def test_damping_is_not_the_back_emf_of_another_joints_motor():
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(DOUBLE)))
    terms = all_terms(ctx, ("viscous_damping", "back_emf"))
    places = {(t.id, t.place.name): t for t in terms}
    emf = places["back_emf", "elbow_motor"]
    assert same(ctx, places["viscous_damping", "elbow"], emf)
    assert not same(ctx, places["viscous_damping", "shoulder"], emf)


def test_what_limits_a_drive_limits_its_bias_too():
    for old, new in (
        ('gear="3"', 'gear="3" forcelimited="true" forcerange="-1 1"'),
        ('damping="2"', 'damping="2" actuatorfrclimited="true" actuatorfrcrange="-1 1"'),
    ):
        two = TABLE_XY.replace(old, new).replace(
            '<motor name="y_drive"', '<motor joint="x"/><motor name="y_drive"'
        )
        ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(two)))
        places = {(t.id, t.place.name): t for t in all_terms(ctx, ("actuator_bias", "external_force"))}
        assert not same(ctx, places["actuator_bias", "x_drive"], places["external_force", "bridge"])


def test_a_force_on_what_slides_askew_is_not_the_bias_of_one_drive():
    askew = TABLE_XY.replace('axis="0 1 0" damping', 'axis="1 1 0" damping')
    for xml, alike in ((TABLE_XY, True), (askew, False)):
        ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
        places = {(t.id, t.place.name): t for t in all_terms(ctx, ("actuator_bias", "external_force"))}
        bias = places["actuator_bias", "x_drive"]
        assert same(ctx, bias, places["external_force", "head"]) == alike
        assert same(ctx, bias, places["external_force", "bridge"])
        assert same(ctx, bias, places["external_force", "world"]) == alike
        assert not same(ctx, places["actuator_bias", "y_drive"], places["external_force", "bridge"])
