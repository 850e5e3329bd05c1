"""The alternation of measurement model and physics: what moves is read anew, and the search goes on from there."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Recording, pipeline
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.measurement import measurement_model
from mpge_jax.diagnosis.measurement.delay_within_a_row import Arrival
from mpge_jax.diagnosis.measurement.measurement_model import MeasurementModel
from mpge_jax.diagnosis.selection import procedure
from mpge_jax.diagnosis.selection.procedure import Decision, Look
from tests.diagnosis.machines import PENDULUM
from tests.diagnosis.searches import COULOMB, fitted

PARTS = ("steps", "delays", "zeros")
SERVO = PENDULUM.replace("<motor", '<position kp="5"')


@pytest.fixture(scope="module")
def decision(rubbing):
    s, _ = rubbing
    f = fitted(s, {COULOMB: [0.1]})
    return Decision(f, {COULOMB: []}, Floor(), None, None)


class Bench:
    """The pipeline with searches, decisions and ways of reading that are told beforehand; what they were asked."""

    def __init__(self, monkeypatch, moves, looks, decisions):
        self.asked, self.looked, self.decided = [], [], []
        looks, decisions = iter(looks), iter(decisions)

        def way(name):
            def moved(m, found):
                self.asked.append((name, found))
                again = [*m.at_rows.warnings, name]
                return replace(m, at_rows=replace(m.at_rows, warnings=again)) if name in moves else None

            return moved

        def look(p, s):
            self.looked.append((list(p.warnings), s.resume.fit, list(s.log)))
            s.log.append(f"look {len(self.looked)}")
            return next(looks)

        def decide(p, _s, _say, looked):
            self.decided.append((list(p.warnings), looked))
            return next(decisions)

        monkeypatch.setattr(pipeline, "WAYS", tuple(map(way, PARTS)))
        monkeypatch.setattr(pipeline, "look", look)
        monkeypatch.setattr(pipeline, "decide", decide)

    def run(self, p):
        return pipeline.find(p, compile_variable(p.spec), pipeline.Progress(quiet=True))


def seen(found, steady=True):
    return Look(found.fit, Floor() if steady else None, found.left, None, [])


@pytest.fixture
def machine(rubbing):
    return replace(rubbing[1], warnings=[])


@pytest.mark.parametrize("moves", [(), PARTS[:1], PARTS[1:2], PARTS[2:], PARTS])
def test_the_search_goes_on_where_the_recordings_are_read_otherwise(machine, decision, moves, monkeypatch):
    looks = [seen(decision) for _ in range(len(moves) + 1)]
    bench = Bench(monkeypatch, moves, looks, [decision])
    d = bench.run(machine)
    assert [name for name, _ in bench.asked] == list(PARTS)
    assert [w for w, _, _ in bench.looked] == [list(moves[:k]) for k in range(len(moves) + 1)]
    assert [f for _, f, _ in bench.looked] == [NOTHING, *[decision.fit] * len(moves)]
    assert [len(log) for _, _, log in bench.looked] == list(range(len(looks))) and len(d.log) == len(looks)
    # alternatives are weighed once, by what was read last
    assert [w for w, _ in bench.decided] == [list(moves)] and bench.decided[0][1] is looks[-1]
    assert d.verdict == "effects" and d.prepared.warnings[: len(moves)] == list(moves)


def test_where_weighing_ends_elsewhere_the_recordings_are_asked_once_more(machine, decision, monkeypatch):
    first, other = PARTS[:1], PARTS[1:]
    nothing = replace(decision, fit=NOTHING, rivals={})
    bench = Bench(monkeypatch, first, [seen(nothing), seen(nothing)], [decision])
    assert bench.run(machine).verdict == "effects"
    assert [name for name, _ in bench.asked] == [*PARTS, *other]
    assert all(found is decision for _, found in bench.asked[len(PARTS) :]) and len(bench.decided) == 1


def test_what_moves_after_that_is_weighed_again(machine, decision, monkeypatch):
    nothing = replace(decision, fit=NOTHING, rivals={})
    looks = [seen(nothing, steady=False), seen(decision)]
    bench = Bench(monkeypatch, PARTS[:1], looks, [decision, decision])
    bench.run(machine)
    # by what is told badly yet nothing is read
    assert [found for _, found in bench.asked] == [decision, looks[1], looks[1]]
    assert [looked for _, looked in bench.decided] == looks


def test_another_remainder_asks_the_recordings_too(machine, decision, monkeypatch):
    left = replace(seen(decision), left=object())
    bench = Bench(monkeypatch, (), [left], [decision])
    bench.run(machine)
    assert len(bench.asked) == 2 * len(PARTS)


@pytest.mark.parametrize(
    ("looked", "after", "again"),
    [(True, 3.9, False), (True, 1.0, True), (False, 3.9, True), (False, 1.0, True)],
)
def test_joints_are_looked_at_together_again_where_another_reading_takes_much_away(
    decision, monkeypatch, looked, after, again
):
    monkeypatch.setattr(procedure, "_usual", lambda s, _f: s.usual)
    before = SimpleNamespace(log=["found"], looked=looked, usual=4.0)
    anew = SimpleNamespace(log=[], looked=False, usual=after)
    procedure.go_on(anew, before, decision.fit)
    assert (not anew.looked) == again and anew.log is before.log and anew.resume.fit is decision.fit


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


def test_doubts_about_recordings_are_told_before_the_search(monkeypatch, capsys):
    """Degrees take minutes to search in vain."""

    def find(p, _plain, _say, _progress):
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "find", find)
    time = 0.01 * np.arange(300)
    swing = np.degrees(np.sin(3.0 * time) + 6.0)[:, None]
    log = Recording("swings", time, swing, None, np.sin(time)[:, None])
    with pytest.raises(KeyboardInterrupt):
        pipeline.diagnose(mujoco.MjSpec.from_string(SERVO), [log])
    assert "take note: swings: positions of hinge look like degrees" in capsys.readouterr().err
