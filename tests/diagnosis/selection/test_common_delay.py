"""All commands late, and all encoders late by as much: the same log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.evidence.scored import Rival, Scored
from mpge_jax.diagnosis.selection.alternatives import _all_at_once
from mpge_jax.diagnosis.selection.search_state import Search
from tests.diagnosis.machines import ARM, record
from tests.diagnosis.searches import fitted, search_of

ROWS, RATE = 4, 100
DELAY = ROWS / RATE
SENSORS = ("sensor_delay@shoulder", "sensor_delay@elbow")
DRIVES = ("actuator_delay@shoulder_motor", "actuator_delay@elbow_servo")


@pytest.fixture(scope="module")
def late() -> tuple[Search, dict[str, Term]]:
    """Logs of which each row holds the motion of four rows before."""
    runs = []
    for r in record(ARM, [1.0, 0.6], count=4, seconds=3.0):
        runs.append(replace(r, time=r.time[ROWS:] - DELAY, qpos=r.qpos[:-ROWS], ctrl=r.ctrl[ROWS:]))
    s, _ = search_of(ARM, runs)
    return s, {str(t): t for t in s.terms}


def rivals_of(s: Search, parts: dict[Term, float]) -> dict[Term, list[Rival]]:
    start = fitted(s, {t: [x] for t, x in parts.items()})
    found = fit(s.sim, [start], s.train, s.whiten_one(start, s.train), iterations=4)[0]
    whites = s.whiten(found)
    (best,) = s.score([found], whites)
    known: dict[Hypothesis, Scored] = {}
    rivals = {t: _all_at_once(s, best, whites, t, known) for t in found.hypothesis.named}
    # what ties with both is fitted once
    assert len({id(r.fit) for each in rivals.values() for r in each}) == len(known) <= 1
    return rivals


@pytest.mark.parametrize(("all_of_them", "others"), [(SENSORS, DRIVES), (DRIVES, SENSORS)])
def test_they_tie_whichever_was_found(late, all_of_them, others):
    s, terms = late
    rivals = rivals_of(s, {terms[name]: DELAY for name in all_of_them})
    for name, other in zip(all_of_them, others, strict=True):
        (rival,) = rivals[terms[name]]
        assert rival.tied and not rival.better
        # first what acts at the same joint
        assert str(rival.term) == other and {str(t) for t in (rival.term, *rival.beside)} == set(others)
        its = rival.fit.hypothesis.split(s.sim.ctx, rival.fit.theta)
        np.testing.assert_allclose([its[terms[name]][0] for name in others], DELAY, atol=0.003)


def test_one_late_encoder_of_two_is_no_late_drive(late):
    s, terms = late
    rivals = rivals_of(s, {terms[SENSORS[0]]: DELAY, terms[DRIVES[1]]: DELAY})
    assert not any(rivals.values())
