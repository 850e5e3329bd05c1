"""A size that differs between recordings is told as that; laws of angle and speed are not."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.selection.remainder import leaves
from mpge_jax.diagnosis.verdict.differing_recordings import Linear, as_recordings_differ, by_stretch
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import COULOMB, GAIN, fitted, search_of


def days(changes, xml=PENDULUM):
    """Recordings of which each is of a machine of its own."""
    every = (record(xml, 0.6, change=x, count=4, seconds=3.0, seed=k)[k % 3] for k, x in enumerate(changes))
    return [replace(r, name=f"day_{k}") for k, r in enumerate(every)]


def told(changes, start, xml=PENDULUM) -> str | None:
    """Around the best fit of one size for all."""
    s, p = search_of(xml, days(changes, xml))
    begun = fitted(s, start)
    (f,) = fit(s.sim, [begun], s.train, s.whiten_one(begun, s.train))
    return as_recordings_differ(p, leaves(s, f), 0)


def geared(gain):
    return lambda m: m.actuator_gear.__setitem__((0, 0), gain)


def rubbing(level):
    return lambda m: m.dof_frictionloss.__setitem__(0, level)


def test_a_gain_that_differs_is_told_with_the_recordings_where_it_is_least_and_most():
    # the third and fourth only judge
    words = told([geared(x) for x in (1.0, 0.9, 0.5, 0.5, 0.85, 0.7)], {GAIN: [0.85]})
    assert words is not None and words.startswith("it is as if the gain of motor changed, from ")
    least, most = words.split(", from ")[1].split(" to ")
    assert least.endswith("in day_5") and most.endswith("in day_0") and " times the model's " in least
    assert float(least.split()[0]) == pytest.approx(0.7, abs=0.05)
    assert float(most.split()[0]) == pytest.approx(1.0, abs=0.05)


def test_dry_friction_that_differs_is_told_beside_what_the_model_has():
    rubs = PENDULUM.replace('armature="0.004"', 'armature="0.004" frictionloss="0.1"')
    words = told([rubbing(x) for x in (0.08, 0.1, 0.3, 0.3, 0.06, 0.15)], {COULOMB: [0.01]}, rubs)
    assert words is not None and "dry friction of the hinge changed" in words
    # each recording has a speed of its own
    assert words.endswith("in day_5 (or damping of the hinge or the gain of motor)")
    words = words.partition(" (or ")[0]
    least, most = words.split(", from ")[1].split(" to ")
    assert " N m less than the model's " in least and " N m more than the model's " in most
    assert float(most.split()[0]) == pytest.approx(0.05, abs=0.02)


def test_the_verdict_says_it():
    d = diagnose(
        mujoco.MjSpec.from_string(PENDULUM),
        days([geared(x) for x in (1.0, 0.9, 0.5, 0.5, 0.85, 0.7)]),
        Config(jobs=1, quiet=True, effects=("actuator_gain", "coulomb_friction", "joint_stiffness")),
    )
    assert d.verdict == "unexplained"
    assert "as if the gain of motor changed, from 0.7" in d.unexplained["when"]


@pytest.mark.parametrize("sizes", [{GAIN: [0.85]}, {COULOMB: [0.1]}])
def test_what_is_the_same_in_all_recordings_is_not(sizes):
    def grinding(m):
        m.dof_damping[0] += 0.05
        m.jnt_stiffness[0] = 0.3

    assert told([grinding] * 6, sizes) is None


def linear(missing, stretches, slope=1.0):
    """Windows of one number each, whose slope is one."""
    flat = -np.array(missing, float)[:, None]
    return Linear(flat, np.full_like(flat, slope), np.ones(flat.size), np.array(list(stretches)), 1.0)


def test_shares_by_hand():
    """What is missing is 10 in four windows and 30 in four."""
    left, sizes = by_stretch(linear([10.0] * 4 + [30.0] * 4, "aaaabbbb"))
    assert left == 0.0
    np.testing.assert_allclose([sizes["a"].value, sizes["b"].value], [11.0, 31.0])
    # a size that windows show is no surer than noise lets it be
    assert sizes["a"].error > 0.5 and sizes["a"].least < 11.0 < sizes["a"].most
    # stretches that are alike leave as much with a size each: by chance more
    left, sizes = by_stretch(linear([10.0, 10.0, 30.0, 30.0] * 2, "abababab"))
    assert left == pytest.approx(8 / 6)


def test_what_few_windows_tell_or_noise_alone_leaves_is_nothing():
    _, sizes = by_stretch(linear([10.0] * 4 + [90.0], "aaaab"))
    assert set(sizes) == {"a"}
    assert by_stretch(linear([10.0, 30.0], "ab")) == (1.0, {})
    assert by_stretch(linear([0.1] * 8, "aaaabbbb"))[0] == 1.0
    # where the effect does nothing its size is not known
    _, sizes = by_stretch(linear([10.0] * 4, "aaaa", slope=0.0))
    assert sizes["a"].error > 1e100
