"""The alternation of measurement model and physics: what moves is read anew, and the search goes on from there."""

from dataclasses import replace

import numpy as np
import pytest

from mpge_jax.diagnosis import pipeline
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.measurement import measurement_model
from mpge_jax.diagnosis.measurement.delay_within_a_row import Arrival
from mpge_jax.diagnosis.measurement.measurement_model import MeasurementModel
from mpge_jax.diagnosis.selection.procedure import Decision
from tests.diagnosis.searches import COULOMB, fitted

PARTS = ("with_moved_steps", "with_moved_delays", "with_moved_zeros")


@pytest.fixture(scope="module")
def decision(rubbing):
    s, _ = rubbing
    f = fitted(s, {COULOMB: [0.1]})
    return Decision(f, {COULOMB: []}, Floor(), None, None)


@pytest.mark.parametrize("moves", [(), PARTS[:1], PARTS[1:2], PARTS[2:], PARTS])
def test_the_search_goes_on_where_the_recordings_are_read_otherwise(rubbing, decision, moves, monkeypatch):
    p = replace(rubbing[1], warnings=[])
    asked, seen = [], []

    def part(name):
        def moved(m, found):
            assert found is decision
            asked.append(name)
            again = [*m.at_rows.warnings, name]
            return replace(m, at_rows=replace(m.at_rows, warnings=again)) if name in moves else None

        return moved

    def decide(q, s, _say):
        seen.append((list(q.warnings), s.resume.fit, list(s.log)))
        s.log.append(f"decision {len(seen)}")
        return decision

    for name in PARTS:
        monkeypatch.setattr(MeasurementModel, name, part(name))
    monkeypatch.setattr(pipeline, "decide", decide)
    d = pipeline.find(p, compile_variable(p.spec), pipeline.Progress(quiet=True))
    assert asked == list(PARTS)
    assert [w for w, _, _ in seen] == [list(moves[:k]) for k in range(len(moves) + 1)]
    assert [f for _, f, _ in seen] == [NOTHING, *[decision.fit] * len(moves)]
    assert [len(log) for _, _, log in seen] == list(range(len(moves) + 1)) and len(d.log) == len(seen)
    assert d.verdict == "effects" and d.prepared.warnings[: len(moves)] == list(moves)


def test_delays_move_where_those_of_the_physics_found_differ_clearly(rubbing, decision, monkeypatch):
    _, p = rubbing
    late = {0: (0.0, 0.01)}
    told = {0: Arrival(0.006, 0.0005)}
    monkeypatch.setattr(measurement_model, "arrivals", lambda at_rows, f, rows: told)
    m = MeasurementModel(p, late, {0: Arrival(0.002, 0.0005)})
    again = m.with_moved_delays(decision)
    assert again is not None and again.delays == told and again.at_rows is p
    near = MeasurementModel(p, late, {0: Arrival(0.0055, 0.0005)})
    assert near.with_moved_delays(decision) is None
    assert m.with_moved_delays(replace(decision, fit=NOTHING)) is None


def test_zeros_are_asked_for_only_where_something_is_left(rubbing, decision, monkeypatch):
    _, p = rubbing
    offset = {p.train[0].recording.name: np.array([0.02])}
    monkeypatch.setattr(measurement_model, "other_zeros", lambda *_: offset)
    monkeypatch.setattr(measurement_model, "arrivals", lambda *_: {0: Arrival(0.006, 0.0005)})
    m = MeasurementModel(replace(p, warnings=[]), {0: (0.0, 0.01)}, {})
    assert m.with_moved_zeros(decision) is None and m.at_rows.warnings == []
    again = m.with_moved_zeros(replace(decision, left=object()))
    assert again is not None and len(m.at_rows.warnings) == 1
    # the delays are those of the physics that was found
    assert again.delays[0].delay == 0.006
    before, after = (x.train[0].recording.qpos for x in (p, again.at_rows))
    np.testing.assert_allclose(before - after, 0.02)
