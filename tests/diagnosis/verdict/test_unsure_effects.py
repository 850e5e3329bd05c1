"""Effects that may be none where something is left that has no name, and what is left that may be nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.held_out_error import fit_report
from mpge_jax.diagnosis.selection.procedure import Decision, what_is_left
from mpge_jax.diagnosis.verdict import judgement
from tests.diagnosis.searches import GAIN, fitted


def test_what_may_be_none_may_be_a_part_of_what_is_left_wherever_it_acts(rubbing, monkeypatch):
    s, p = rubbing
    monkeypatch.setattr(judgement, "residual_of_motion", lambda *_: None)
    monkeypatch.setattr(judgement, "doubtful", lambda *_: ())
    verdicts = {}
    for deviation in (0.1, 0.3):
        gain = replace(fitted(s, {GAIN: [1.5]}), cov=np.array([[deviation**2]]))
        found = Decision(gain, {GAIN: []}, *what_is_left(p, gain, s), s)
        result = judgement.judge(p, s.sim.model, s, found, fit_report(p, gain, "test"), None)
        verdicts[deviation] = result.verdict, result.doubtful
    assert verdicts == {0.1: ("unexplained", ()), 0.3: ("unexplained", (GAIN,))}


@pytest.mark.parametrize(("noise", "verdict"), [(1.0, "unexplained"), (1e3, "none")])
def test_what_no_prediction_misses_by_more_than_noise_is_nothing(rubbing, monkeypatch, noise, verdict):
    """Recorded velocities may be off, and positions as they should be."""
    s, p = rubbing
    monkeypatch.setattr(judgement, "residual_of_motion", lambda *_: None)
    found = Decision(NOTHING, {}, *what_is_left(p, NOTHING, s), s)
    assert found.left is not None
    held = fit_report(p, NOTHING, "test").above(noise)
    assert judgement.judge(p, s.sim.model, s, found, held, None).verdict == verdict
