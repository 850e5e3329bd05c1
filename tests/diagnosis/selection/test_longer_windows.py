"""Where nothing was found or something is left, a search goes on in longer windows as long as that helps."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mpge_jax.diagnosis import Config
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.evidence.scored import Reached
from mpge_jax.diagnosis.selection import procedure
from tests.diagnosis.searches import ARMATURE, COULOMB, DAMPING


def _fit(*terms) -> Fitted:
    h = Hypothesis.of(*terms)
    return Fitted(h, NOTHING.theta, NOTHING.centre)


ONE, TWO, THREE = _fit(COULOMB), _fit(COULOMB, DAMPING), _fit(COULOMB, DAMPING, ARMATURE)


class Bench:
    """A search whose longer windows find what it is told that they find, by their length in seconds."""

    def __init__(self, monkeypatch, found, usual=None, better=True, longest=100.0):
        self.sim, self.searched, self.whole = SimpleNamespace(stride=1, rugged=lambda h: False), [], longest
        self.found, self.usual = found, usual or (lambda length: length)
        monkeypatch.setattr(procedure, "build_search", self.build)
        monkeypatch.setattr(procedure, "search", self.search)
        monkeypatch.setattr(procedure, "needed_fit", lambda s, f: (f, (None, None)))
        monkeypatch.setattr(procedure, "_weighed", self.weighed)
        monkeypatch.setattr(procedure, "_usual", lambda s, f: self.usual(s.length))
        monkeypatch.setattr(procedure, "predicts_better", lambda p, new, old: better)

    def build(self, p, say, length):
        self.sim.stride = length
        length = min(length, self.whole)
        count = round(40 / length)
        train = SimpleNamespace(steps=1000 * length, count=count, times=SimpleNamespace(max=lambda: length))
        held = SimpleNamespace(count=count)
        return SimpleNamespace(
            train=train,
            held=held,
            length=length,
            sim=self.sim,
            looked=False,
            floor=None,
            log=[str(length)],
        )

    def search(self, s):
        self.searched.append((s.length, s.resume.fit))
        return self.found[s.length], []

    def weighed(self, s, f, whites, last):
        return f, {"rivals": s.length}

    def run(self, f, begins=0.5):
        p = SimpleNamespace(config=Config())
        s = self.build(p, None, 0.25)
        self.sim.stride = 1
        return procedure._on_longer_windows(p, s, f, {}, begins, lambda text: None)


@pytest.mark.parametrize(
    ("found", "options", "begins", "ends", "lengths"),
    [
        pytest.param({0.5: TWO, 1.0: TWO}, {}, ONE, TWO, [0.5, 1.0], id="until nothing is found"),
        pytest.param(
            {0.5: TWO, 1.0: THREE, 2.0: THREE}, {}, ONE, THREE, [0.5, 1.0, 2.0], id="as often as that finds more"
        ),
        pytest.param({0.5: TWO}, {"better": False}, ONE, ONE, [0.5], id="no gain for others"),
        pytest.param({}, {"usual": lambda length: -length}, ONE, ONE, [], id="unpredictable"),
        pytest.param({0.5: TWO}, {"longest": 0.5}, ONE, TWO, [0.5], id="short recordings"),
        pytest.param({0.5: ONE, 1.0: ONE}, {"usual": lambda length: -length}, NOTHING, ONE, [0.5], id="nothing so far"),
        pytest.param({0.5: NOTHING}, {}, NOTHING, NOTHING, [0.5], id="nothing there either"),
    ],
)  # fmt: skip
def test_windows_become_longer_as_long_as_that_helps(monkeypatch, found, options, begins, ends, lengths):
    bench = Bench(monkeypatch, found, **options)
    f, rivals, longest = bench.run(begins)
    assert f is ends
    assert [length for length, _ in bench.searched] == lengths
    kept = [length for length in lengths if found[length] is ends]
    assert rivals == ({} if f is begins else {"rivals": kept[0]})
    assert longest.length == max([0.25, *lengths])
    assert bench.sim.stride == 1


def test_each_search_goes_on_from_what_the_last_one_found(monkeypatch):
    bench = Bench(monkeypatch, {0.5: TWO, 1.0: THREE, 2.0: THREE})
    bench.run(ONE)
    assert [f for _, f in bench.searched] == [ONE, TWO, THREE]


def test_it_begins_where_something_is_left(monkeypatch):
    bench = Bench(monkeypatch, {1.0: TWO, 2.0: TWO})
    assert bench.run(ONE, begins=1.0)[0] is TWO
    assert [length for length, _ in bench.searched] == [1.0, 2.0]


@pytest.mark.parametrize(
    ("share", "there", "shows", "found", "asked"),
    [
        (0.05, 0.0, (1.0,), 1.0, [0.5, 1.0]),
        (0.05, 0.0, (), None, [0.5, 1.0, 2.0]),  # no recording is longer
        (0.01, 0.0, (1.0,), None, [0.5]),
        (0.01, 0.0, (0.5, 1.0), 0.5, [0.5]),
        (0.01, 0.3, (1.0,), 1.0, [0.5, 1.0]),  # it drowns in what the other joint had
    ],
)
def test_longer_windows_are_asked_where_more_than_a_slight_rest_is_reported(
    monkeypatch, share, there, shows, found, asked
):
    bench, lengths = Bench(monkeypatch, {}, longest=2.0), []

    def what_is_left(_p, _f, s):
        lengths.append(s.length)
        return Floor(), s.length if s.length in shows else None

    monkeypatch.setattr(procedure, "what_is_left", what_is_left)
    report = SimpleNamespace(left=lambda rugged: share**0.5, left_at=lambda dofs: there * dofs[1])
    monkeypatch.setattr(procedure, "fit_report", lambda *_: report)
    monkeypatch.setattr(procedure, "amounts_seen", lambda *_: {})
    p = SimpleNamespace(config=Config(), model=SimpleNamespace(njnt=2, dof_jntid=np.arange(2)))
    s = bench.build(None, None, 0.25)
    bench.sim.stride = 1
    left, length = procedure._left_of_longer_windows(p, s, ONE, lambda _: None)
    assert left == found and lengths == asked and bench.sim.stride == 1
    assert found is None or length == found


def test_a_few_windows_decide_nothing(monkeypatch):
    bench = Bench(monkeypatch, {0.5: TWO, 1.0: THREE})
    monkeypatch.setattr(procedure, "ENOUGH_WINDOWS", 41)
    assert bench.run(ONE)[0] is TWO
    assert [length for length, _ in bench.searched] == [0.5]


@pytest.mark.parametrize("shows", [(), (0.5,), (0.25, 0.5)])
def test_what_is_left_is_judged_in_all_windows_that_were_looked_at(monkeypatch, shows):
    bench = Bench(monkeypatch, {0.25: NOTHING, 0.5: NOTHING})
    floors, judged = [], []

    def floor(p, f, length):
        floors.append(length)
        return Floor()

    def remainder(s, f, noise):
        judged.append(s.length)
        return s.length if s.length in shows else None

    monkeypatch.setattr(procedure, "floor", floor)
    monkeypatch.setattr(procedure, "remainder", remainder)
    monkeypatch.setattr(procedure, "confirmed", lambda p, s, f, part: (f, None, []))
    s = bench.build(None, None, 0.25)
    s.resume = Reached()
    p = SimpleNamespace(config=Config())
    found = procedure.decide(p, s, lambda text: None, procedure.look(p, s))
    assert found.left == (min(shows) if shows else None)
    assert found.search.length == 0.5
    assert floors == judged and set(judged) == ({0.25} if 0.25 in shows else {0.25, 0.5})
