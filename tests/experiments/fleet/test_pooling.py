"""Shared values, spreads and robots that stand out: worked by hand, and on fleets of equals."""

import numpy as np
import pytest

from experiments.fleet.pooling import distance, pool, shrunk, standing_out


def test_two_robots_by_hand():
    y, s = np.array([0.0, 2.0]), np.array([1.0, 1.0])
    pooled = pool(y, s)
    # 2 / (1 + tau^2) = 1 at tau = 1; the mean of two numbers of variance 2 has variance 1.
    assert (pooled.value, pooled.error, pooled.spread) == pytest.approx((1.0, 1.0, 1.0))
    assert pooled.spread_interval[0] == 0.0 < 1.0 < pooled.spread_interval[1]
    # Own estimate and fleet weigh the same: half of the way.
    np.testing.assert_allclose(shrunk(y, s, pooled), [0.5, 1.5])


def test_robots_that_agree_have_no_spread_and_errors_weigh():
    pooled = pool(np.array([1.0, 1.3]), np.array([0.1, 0.2]))
    # Weights 100 and 25; (0.06^2 * 100 + 0.24^2 * 25) = 1.8 > 1, so a little spread.
    assert 0 < pooled.spread < 0.3 and 1.0 < pooled.value < 1.15
    same = pool(np.array([1.0, 1.0, 1.0]), np.full(3, 0.3))
    assert (same.value, same.spread) == (1.0, 0.0) and same.error == pytest.approx(0.3 / 3**0.5)
    np.testing.assert_allclose(shrunk(np.array([1.2]), np.array([0.3]), same), [1.0])
    alone = pool(np.array([4.0]), np.array([0.5]))
    assert (alone.value, alone.error, alone.spread, alone.spread_interval) == (4.0, 0.5, 0.0, None)


def test_one_odd_robot_does_not_hide_another():
    y = np.array([0, 0.1, -0.1, 0.05, -0.05, 0.02, -0.02, 0.08, 5, 5.1])
    assert standing_out(y, np.full(10, 0.05)).tolist() == [False] * 8 + [True] * 2
    # An estimate that says nothing is nowhere.
    s = np.full(10, 0.05)
    s[8:] = 10.0
    assert not standing_out(y, s).any()
    # Of three, none can be told to be the odd one.
    assert not standing_out(y[-3:], s[:3]).any()
    assert distance(2.0, 0.0, np.array([0.0, 0.0]), np.array([1.0, 1.0])) == pytest.approx(2.0 * 2**0.5)


def test_in_fleets_of_equals_few_stand_out():
    rng = np.random.default_rng(0)
    fleets = [rng.normal(1.0, np.hypot(0.2, 0.3), 8) for _ in range(100)]
    alarms = sum(standing_out(y, np.full(8, 0.3)).any() for y in fleets)
    # One in twenty at most is meant; eleven would come once in two hundred such tests.
    assert alarms <= 10
