"""Rows of recordings, as finely as motion and force are known."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis.force_balance.tracks import Resolution, tracks
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import prepared_of


@pytest.fixture(scope="module")
def swinging():
    return prepared_of(PENDULUM, record(PENDULUM, 0.8, count=4, seconds=1.0))


@pytest.mark.parametrize("other", [{"sensor": 5.0}, {"lag": 0.01}, {"still": 0.1}, {"held": True}])
def test_the_motion_hangs_on_its_own_resolution_alone(swinging, other):
    """Inverse dynamics are computed once for all that share it (`resolution.choose`)."""
    plain, changed = (
        tracks(swinging, swinging.looked_at, 200, Resolution(motion=5.0, **more)) for more in ({}, other)
    )
    for a, b in zip(plain, changed, strict=True):
        for name in ("time", "q", "v", "a"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_a_coarser_motion_is_another_one(swinging):
    fine, coarse = (tracks(swinging, swinging.looked_at, 200, Resolution(motion=x)) for x in (np.inf, 2.0))
    assert all(np.abs(a.a - b.a).max() > 0.1 for a, b in zip(fine, coarse, strict=True))
