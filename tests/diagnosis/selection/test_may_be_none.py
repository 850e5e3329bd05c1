"""Effects of which the interval that is reported holds that there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.selection import procedure
from mpge_jax.diagnosis.selection.backward_elimination import final_fit
from mpge_jax.diagnosis.selection.criteria import may_be_none
from mpge_jax.diagnosis.selection.procedure import Decision
from tests.diagnosis.searches import COULOMB, GAIN, fitted


def test_an_interval_that_holds_null_is_told_weakest_first(rubbing):
    s, _ = rubbing
    f = replace(fitted(s, {COULOMB: [0.1], GAIN: [1.1]}), cov=np.diag([0.06**2, 0.1**2]))
    assert may_be_none(s, f) == [GAIN, COULOMB]
    # 2 deviations from none of the one, half a deviation of the other
    assert may_be_none(s, replace(f, cov=np.diag([0.05**2, 0.2**2]))) == [GAIN]
    assert may_be_none(s, replace(f, cov=np.diag([0.05**2, 0.05**2]))) == []
    # nothing is known against what has no interval
    assert may_be_none(s, fitted(s, {COULOMB: [0.1]})) == []


@pytest.mark.parametrize("missed", [False, True])
def test_it_goes_where_nothing_is_left_without_it(rubbing, monkeypatch, missed):
    """The truth is dry friction of 0.1 N m; nothing is wrong with the gain."""
    s, p = rubbing
    monkeypatch.setattr(procedure, "_kept", lambda p, s, found, part: (found, None))
    if missed:
        monkeypatch.setattr(procedure, "what_is_left", lambda *_: (Floor(), "something"))
    p.warnings.clear()
    f, _ = final_fit(s, fitted(s, {COULOMB: [0.1], GAIN: [1.0]}))
    found, _ = procedure.tested(p, s, Decision(f, {COULOMB: [], GAIN: []}, Floor(), None, s))
    assert set(found.fit.hypothesis.terms) == ({COULOMB, GAIN} if missed else {COULOMB})
    assert set(found.rivals) == set(found.fit.hypothesis.terms)
    assert len(p.warnings) == (not missed) and all(procedure.MAY_BE_NONE in w for w in p.warnings)
    assert found.fit.theta[found.fit.hypothesis.terms.index(COULOMB)] == pytest.approx(0.1, rel=0.05)
