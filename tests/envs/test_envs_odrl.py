"""ODRL's shifts: their names, and exactly the fields that each changes, by its factor."""

import numpy as np
import pytest

import envs
from envs.variants.odrl import ODRL

FIELDS = ("geom_friction", "geom_size", "jnt_range")
BY_NAME = {variant.name: variant for variant in ODRL}


def models(name: str):
    return tuple(envs.make(x, "c").model for x in (name, envs.source_of(name)))


def test_names_and_numbers():
    assert len(BY_NAME) == 2 * (4 + 4 + 2 * 3 + 2 * 3) == len(ODRL)
    assert {name.split("-")[0] for name in BY_NAME} == {"halfcheetah", "hopper"}
    assert {"halfcheetah-friction-0.1", "hopper-kinematic-legjnt-easy", "hopper-morph-foot-hard"} <= set(
        BY_NAME
    )


@pytest.mark.parametrize("name", BY_NAME)
def test_only_what_the_name_says_is_changed(name):
    shifted, plain = models(name)
    changed = {
        field for field in FIELDS if not np.array_equal(getattr(shifted, field), getattr(plain, field))
    }
    changed |= {"gravity"} if not np.array_equal(shifted.opt.gravity, plain.opt.gravity) else set()
    kind = name.split("-")[1]
    wanted = {
        "friction": "geom_friction",
        "kinematic": "jnt_range",
        "morph": "geom_size",
        "gravity": "gravity",
    }
    assert changed == {wanted[kind]}
    assert (shifted.body_mass.sum() != pytest.approx(plain.body_mass.sum())) == (
        kind == "morph" and name.startswith("hopper")
    )


def test_factors():
    for robot in ("halfcheetah", "hopper"):
        for scale in (0.1, 0.5, 2.0, 5.0):
            shifted, plain = models(f"{robot}-friction-{scale}")
            np.testing.assert_allclose(shifted.geom_friction, scale * plain.geom_friction)
            shifted, plain = models(f"{robot}-gravity-{scale}")
            np.testing.assert_allclose(shifted.opt.gravity, scale * plain.opt.gravity)
    for level, factor in (("easy", 0.8), ("medium", 0.5), ("hard", 0.2)):
        shifted, plain = models(f"halfcheetah-kinematic-footjnt-{level}")
        ratio = np.ones(plain.njnt)
        ratio[[plain.joint(joint).id for joint in ("bfoot", "ffoot")]] = factor
        np.testing.assert_allclose(shifted.jnt_range, ratio[:, None] * plain.jnt_range)
    for level, factor in (("easy", 1.25), ("medium", 0.75), ("hard", 1.5)):
        shifted, plain = models(f"hopper-morph-foot-{level}")
        foot = plain.geom("foot_geom").id
        assert shifted.geom_size[foot, 0] == pytest.approx(factor * plain.geom_size[foot, 0])
        assert shifted.geom_size[foot, 1] == plain.geom_size[foot, 1]
