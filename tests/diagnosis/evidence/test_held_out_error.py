"""Errors on held-out recordings."""

from __future__ import annotations

import pytest

from mpge_jax.diagnosis.evidence.held_out_error import fit_report
from tests.diagnosis.searches import COULOMB, fitted


def test_noise_is_told_as_it_was_estimated_also_where_less_is_left(rubbing):
    s, p = rubbing
    report = fit_report(p, fitted(s, {COULOMB: [0.1]}), "test")
    louder = report.above(100.0)
    assert louder.floor == pytest.approx(100.0 * report.floor) and louder.floor > louder.after.rms
    assert louder.left(rugged=False) == 0.0
