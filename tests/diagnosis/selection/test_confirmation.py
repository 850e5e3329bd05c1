"""Effects before recordings that they were not fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.estimation.prediction_error import Errors
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.selection import confirmation
from mpge_jax.diagnosis.selection.confirmation import confirmed
from tests.diagnosis.searches import ARMATURE, COULOMB, DAMPING, GAIN, fitted, slight

WINDOWS = 60


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


def test_what_many_explain_a_little_is_not_given_up_one_by_one(rubbing, monkeypatch):
    s, p = rubbing
    terms = (COULOMB, DAMPING, GAIN, ARMATURE)
    shares = slight(len(terms), WINDOWS)

    def error_of(hypothesis):
        missed = [shares[k] for k, t in enumerate(terms) if t not in hypothesis.terms]
        window = np.sqrt(1000.0 + np.sum(missed, axis=0) + np.zeros(WINDOWS))
        rms = float(np.sqrt((window**2).mean()))
        return Errors(rms, np.zeros(1), window, np.zeros((WINDOWS, 1, 1)))

    whole = fitted(s, {t: [0.1] for t in terms})
    nothing = error_of(NOTHING.hypothesis)
    far = replace(nothing, window=nothing.window + 50.0 + np.arange(WINDOWS), rms=60.0)
    monkeypatch.setattr(
        confirmation,
        "fit_report",
        lambda p, f, part: FitReport(s.held, far, error_of(f.hypothesis), np.zeros(WINDOWS), 0.0),
    )
    monkeypatch.setattr(
        confirmation,
        "errors_without",
        lambda p, f, report: {t: error_of(f.hypothesis.without(t)) for t in f.hypothesis.terms},
    )
    monkeypatch.setattr(confirmation, "_refitted", lambda s, f: f)
    f, _, gone = confirmed(p, s, whole, "test")
    assert len(gone) == 1 and len(f.hypothesis.terms) == 3
