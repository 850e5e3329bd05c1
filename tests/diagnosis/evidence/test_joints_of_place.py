"""Joints at which something acts that has a place."""

from __future__ import annotations

import mujoco

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.evidence.joints_of_place import acted_on, first_joints, next_to
from tests.diagnosis.machines import ARM, FOUR_BAR, ROTORS

MODEL = mujoco.MjModel.from_xml_string(ARM)
SHOULDER, SERVO, FORE = (
    Place("joint", "shoulder", 0),
    Place("actuator", "elbow_servo", 1),
    Place("body", "fore", 2),
)
UPPER, WORLD = Place("body", "upper", 1), Place("world", "world", 0)


def test_a_place_acts_on_its_own_joints():
    assert acted_on(MODEL, SHOULDER) == [0] and acted_on(MODEL, SERVO) == [1]
    # a body is carried by all joints up to the world, a geom goes by its body
    assert acted_on(MODEL, FORE) == [0, 1] and acted_on(MODEL, Place("geom", "", 0)) == [0]
    assert acted_on(MODEL, WORLD) == [0, 1]


def test_a_body_acts_first_at_its_own_joint_and_at_all_of_a_loop():
    assert first_joints(MODEL, SHOULDER) == {0} and first_joints(MODEL, SERVO) == {1}
    assert first_joints(MODEL, FORE) == first_joints(MODEL, Place("geom", "", 1)) == {1}
    assert first_joints(MODEL, WORLD) == {0, 1}
    loop = mujoco.MjModel.from_xml_string(FOUR_BAR)
    assert first_joints(loop, Place("body", "middle", 2)) == {0, 1, 2}
    assert first_joints(loop, Place("body", "beside", 4)) == {3}
    # thrust of a site on the body is no one joint's matter
    assert first_joints(mujoco.MjModel.from_xml_string(ROTORS), Place("actuator", "left", 0)) == {0, 1, 2}


def test_effects_of_one_kind_are_next_to_each_other_at_bodies_of_which_one_carries_the_other():
    load, offset = Term("payload_mass", FORE), Term("com_offset", UPPER)
    assert next_to(MODEL, load, Term("payload_mass", UPPER)) and next_to(
        MODEL, Term("payload_mass", UPPER), load
    )
    assert not next_to(MODEL, load, offset) and not next_to(MODEL, load, load)
    rubs = [Term("coulomb_friction", Place("joint", n, i)) for i, n in enumerate(["shoulder", "elbow"])]
    assert not next_to(MODEL, *rubs)
    loop = mujoco.MjModel.from_xml_string(FOUR_BAR)
    left, right = (Term("payload_mass", Place("body", n, i)) for n, i in (("left", 1), ("right", 3)))
    assert not next_to(loop, left, right)
