"""Arms that stop and go: recordings are what they say, and friction is told by how a joint slides."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from experiments.tuning import stopping_arms
from mpge_jax.diagnosis import Config, diagnose


def test_an_arm_rests_and_moves_and_its_machine_has_what_it_lacks():
    lacks = {"coulomb_friction@lift": 0.7, "viscous_damping@bend": 0.3, "payload_mass@lower": 0.5}
    m, nominal = stopping_arms.machine(lacks), stopping_arms.machine({})
    np.testing.assert_array_equal(m.dof_frictionloss, [0.0, 0.7, 0.0])
    np.testing.assert_array_equal(m.dof_damping, [0.0, 0.0, 0.3])
    assert np.isclose(m.body_mass.sum() - nominal.body_mass.sum(), 0.5)
    r = stopping_arms.recorded(lacks, np.random.default_rng(1), "run")
    assert r.ctrl is None and r.force.shape == r.qpos.shape == (1600, 3)
    slow = np.abs(r.qvel) < 0.01
    assert (slow.mean(0) > 0.05).all() and (slow.mean(0) < 0.95).all()


def test_a_score_counts_what_cannot_be_told_apart_as_said_and_what_is_doubtful_as_not_sure():
    def rival(name):
        return SimpleNamespace(tied=True, term=name)

    d = SimpleNamespace(
        terms=["a@x", "b@y", "c@z"], rivals={"b@y": [rival("d@y")]}, doubtful=["c@z"], verdict="ambiguous",
    )  # fmt: skip
    found = stopping_arms.score({"d@y": 1.0, "e@z": 2.0}, d)
    assert (found["missed"], found["false"]) == (["e@z"], ["a@x"])
    assert stopping_arms.summary([found, {**found, "missed": [], "false": []}]) == (
        "2 arms, 1 all right; 1 of 4 effects missed, 1 false names"
    )


@pytest.mark.slow
def test_friction_of_a_joint_that_stops_and_goes_is_plain():
    lacks, recordings = stopping_arms.case(8)
    assert "coulomb_friction@bend" in lacks
    d = diagnose(mujoco.MjSpec.from_string(stopping_arms.ARM), recordings, Config(jobs=1, quiet=True))
    found = stopping_arms.score(lacks, d)
    assert (found["missed"], found["false"]) == ([], [])
