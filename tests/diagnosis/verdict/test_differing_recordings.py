"""A size that differs between recordings is told as that; laws of angle and speed are not."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.selection.remainder import leaves
from mpge_jax.diagnosis.verdict.differing_recordings import _by_stretch, as_recordings_differ
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import COULOMB, GAIN, fitted, search_of


def told(changes, start) -> str | None:
    """Of recordings of which each is of a machine of its own, around the best fit of one size for all."""
    runs = []
    for k, change in enumerate(changes):
        runs.append(record(PENDULUM, 0.6, change=change, count=4, seconds=3.0, seed=k)[k % 3])
        runs[-1] = runs[-1].__class__(**{**vars(runs[-1]), "name": f"day_{k}"})
    s, p = search_of(PENDULUM, runs)
    begun = fitted(s, start)
    (f,) = fit(s.sim, [begun], s.train, s.whiten_one(begun, s.train))
    return as_recordings_differ(p, leaves(s, f), "hinge")


def geared(gain):
    return lambda m: m.actuator_gear.__setitem__((0, 0), gain)


def rubbing(level):
    return lambda m: m.dof_frictionloss.__setitem__(0, level)


def test_a_gain_that_differs_is_told_with_the_recordings_where_it_is_least_and_most():
    # the third and fourth only judge
    words = told([geared(x) for x in (1.0, 0.9, 0.5, 0.5, 0.85, 0.7)], {GAIN: [0.85]})
    assert words is not None and words.startswith(
        "it is as if the gain of motor changed between recordings, from "
    )
    least, most = words.split(", from ")[1].split(" to ")
    assert "day_5" in least and "day_0" in most
    assert float(least.split()[0]) == pytest.approx(0.7, abs=0.05)
    assert float(most.split()[0]) == pytest.approx(1.0, abs=0.05)


def test_dry_friction_that_differs_is_told_in_its_unit():
    words = told([rubbing(x) for x in (0.05, 0.1, 0.3, 0.3, 0.05, 0.15)], {COULOMB: [0.1]})
    assert words is not None and "dry friction of the hinge changed" in words
    assert words.count(" N m ") == 2 and "day_5" in words.split(" to ")[-1]


@pytest.mark.parametrize("sizes", [{GAIN: [0.85]}, {COULOMB: [0.1]}])
def test_what_is_the_same_in_all_recordings_is_not(sizes):
    def grinding(m):
        m.dof_damping[0] += 0.05
        m.jnt_stiffness[0] = 0.3

    assert told([grinding] * 6, sizes) is None


def test_shares_by_hand():
    """Two stretches of two windows of one number each, whose slope is 1: what is missing is 10 and 30."""
    flat, slope, count = -np.array([[10.0], [10.0], [30.0], [30.0]]), np.ones((4, 1)), np.ones(4)
    left, sizes = _by_stretch(flat, slope, count, np.array(["a", "a", "b", "b"]), size=1.0)
    assert left == 0.0
    np.testing.assert_allclose([sizes["a"], sizes["b"]], [(11.0, 0.0), (31.0, 0.0)], atol=1e-12)
    # stretches that are alike leave as much with a size each: by chance more
    left, sizes = _by_stretch(flat, slope, count, np.array(["a", "b", "a", "b"]))
    assert left == pytest.approx(2.0) and sizes["a"] == sizes["b"]
