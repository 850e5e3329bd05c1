"""Effects before recordings that they were not fitted to."""

from __future__ import annotations

import pytest

from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.selection.confirmation import confirmed
from tests.diagnosis.searches import COULOMB, GAIN, fitted


@pytest.mark.parametrize("part", ["choice", "test"])
def test_an_effect_that_helps_no_other_recording_goes(rubbing, part):
    """The truth is dry friction of 0.1 N m; nothing is wrong with the gain."""
    s, p = rubbing
    for parts, stay in (
        ({COULOMB: [0.1]}, {COULOMB}),
        ({COULOMB: [0.6]}, set()),
        ({GAIN: [1.5]}, set()),
        ({COULOMB: [0.1], GAIN: [1.3]}, {COULOMB}),
    ):
        f, report, gone = confirmed(p, s, fitted(s, parts), part)
        assert set(f.hypothesis.terms) == stay and set(gone) == set(parts) - stay
        assert (report.after.rms < report.before.rms) == bool(stay)
    assert confirmed(p, s, NOTHING, part)[2] == []


def test_the_others_are_fitted_again(rubbing):
    s, p = rubbing
    f, _, _ = confirmed(p, s, fitted(s, {COULOMB: [0.15], GAIN: [1.3]}), "choice")
    assert f.theta == pytest.approx([0.1], rel=0.1)
