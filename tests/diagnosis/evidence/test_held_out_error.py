"""Errors on held-out recordings."""

from __future__ import annotations

import pytest

from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.held_out_error import fit_report, helps
from tests.diagnosis.searches import COULOMB, GAIN, fitted


def test_what_predicts_held_out_recordings_no_better_is_dropped(rubbing):
    s, p = rubbing
    found = {
        k: fit_report(p, fitted(s, {t: [k]}), held=True)
        for t, k in ((COULOMB, 0.1), (COULOMB, 0.6), (GAIN, 1.5))
    }
    assert {k: helps(report) for k, report in found.items()} == {0.1: True, 0.6: False, 1.5: False}
    assert helps(fit_report(p, NOTHING, held=True))


def test_noise_is_told_as_it_was_estimated_also_where_less_is_left(rubbing):
    s, p = rubbing
    report = fit_report(p, fitted(s, {COULOMB: [0.1]}), held=True)
    louder = report.above(100.0)
    assert louder.floor == pytest.approx(100.0 * report.floor) and louder.floor > louder.after.rms
    assert louder.left(rugged=False) == 0.0
