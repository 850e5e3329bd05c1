"""Whether a number differs from recording to recording, or from part to part of each."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt
from mpge_jax.diagnosis.measurement.between_recordings import _likelihood, between_recordings

PARTS = 3


def told(
    own: np.ndarray, part: float, deviation: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng, of = np.random.default_rng(seed), np.repeat(np.arange(own.size), PARTS)
    noise = rng.normal(scale=np.hypot(part, deviation), size=of.size)
    return own[of] + noise, np.full(of.size, deviation), of


def test_the_likelihood_is_that_of_its_covariance():
    rng, of = np.random.default_rng(0), np.array([0, 0, 0, 1, 1, 3])
    z, d = rng.normal(size=6), rng.uniform(0.1, 0.5, 6)

    def whole(between: float, part: float) -> float:
        cov = np.diag(d**2 + part**2) + between**2 * (of[:, None] == of)
        weights = np.linalg.solve(cov, np.ones(6))
        return float(multivariate_normal(np.full(6, weights @ z / weights.sum()), cov).logpdf(z))

    tried = [(0.0, 0.0), (0.3, 0.0), (0.0, 0.4), (1.0, 0.2)]
    apart = [_likelihood(z, d, of, 4, *x) - whole(*x) for x in tried]
    assert apart == pytest.approx([apart[0]] * len(tried))


def test_what_all_parts_of_a_recording_agree_on_is_its_own():
    own = np.array([0.1, -0.06, 0.0, 0.03, -0.02])
    found = between_recordings(*told(own, 0.005, 0.002, 1), np.ones(5, bool))
    assert beyond_doubt(found.ratio)
    assert found.own == pytest.approx(own, abs=0.01) and found.common == 0.0


def test_what_parts_disagree_on_is_nobodys():
    found = between_recordings(*told(np.zeros(8), 0.06, 0.002, 2), np.ones(8, bool))
    assert not beyond_doubt(found.ratio)
    assert np.abs(found.own).max() < 0.03


def test_what_all_recordings_have_in_common_is_told_apart():
    found = between_recordings(*told(np.full(5, 0.05), 0.001, 0.001, 3), np.ones(5, bool))
    assert found.common == pytest.approx(0.05, abs=1e-3)
    assert not beyond_doubt(found.ratio) and np.abs(found.own).max() < 2e-3


def test_one_part_of_a_recording_that_tells_nothing_of_others_is_drawn_towards_them():
    # the last recording has one part, and the others tell how far recordings (0.02) and parts (0.02) differ
    values = np.array([0.02, 0.05, -0.03, -0.01, 0.03, 0.0, -0.02, -0.03, 0.2])
    of = np.array([0, 0, 1, 1, 2, 2, 3, 3, 4])
    looked = np.array([True, True, True, True, False])
    found = between_recordings(values, np.full(9, 1e-3), of, looked)
    less = between_recordings(np.append(values[:8], 0.1), np.full(9, 1e-3), of, looked)
    assert 0.2 * 0.3 < found.own[4] < 0.2 * 0.8
    # it has no say in how far they do
    assert found.ratio == less.ratio and found.own[4] == pytest.approx(2 * less.own[4])


def test_there_is_no_false_alarm_in_more_than_one_draw_of_twenty():
    alarms = [
        beyond_doubt(between_recordings(*told(np.zeros(6), 0.03, 0.005, k), np.ones(6, bool)).ratio)
        for k in range(100)
    ]
    assert sum(alarms) <= 5
