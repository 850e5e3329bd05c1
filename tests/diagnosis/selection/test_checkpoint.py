"""The state of a search in a file: what comes back is what was kept, and any other content starts anew."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.evidence.scored import Reached, Scored
from mpge_jax.diagnosis.selection import checkpoint
from tests.diagnosis.searches import COULOMB, DAMPING, fitted


def _fit(s, values) -> Fitted:
    f = fitted(s, values)
    many = f.theta.size
    windows = s.train.count + s.held.count
    return Fitted(f.hypothesis, f.theta, f.centre, 0.5, np.eye(many), 2 * np.eye(many), np.ones(windows))


def _scored(s, values) -> Scored:
    windows = s.train.count + s.held.count
    return Scored(
        _fit(s, values), np.ones(s.train.count), np.ones(s.held.count), 1, 2, 1.5, np.ones((windows, 1))
    )


@pytest.fixture
def kept(rubbing, tmp_path, monkeypatch):
    """A search, what it was given, a file with its state, and what that state is."""
    s, p = rubbing
    for name in ("resume", "keep", "looked"):
        monkeypatch.setattr(s, name, getattr(s, name))
    monkeypatch.setattr(p.sim, "work", 7.5)
    path = tmp_path / ".progress.json"
    checkpoint.attach(s, p, path)
    state = Reached(_fit(s, {COULOMB: [0.1]}), (_scored(s, {COULOMB: [0.1]}), _scored(s, {DAMPING: [0.02]})))
    s.keep(state)
    s.resume, p.sim.work = Reached(), 0.0
    return s, p, path, state


def test_what_is_kept_comes_back(kept):
    s, p, path, state = kept
    checkpoint.attach(s, p, path)
    found = s.resume
    assert p.sim.work == 7.5 and found.fit.hypothesis == state.fit.hypothesis
    for a, b in ((found.fit, state.fit), (found.last[1].fit, state.last[1].fit)):
        for name in ("theta", "centre", "information", "cov", "x"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    np.testing.assert_array_equal(found.last[0].each, state.last[0].each)


WRONG = (
    None,
    True,
    -3,
    0.5,
    float("nan"),
    float("inf"),
    "x",
    [],
    [float("nan")],
    [1.0, 2.0],
    [[1.0, 2.0]],
    [[]],
    {},
    {"a": 1},
)


def _places(table, here=()):
    """Where something stands in nested lists and dictionaries."""
    yield here
    inner = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in inner:
        yield from _places(value, (*here, key))


def _changed(table, place, value):
    if not place:
        return value
    out = dict(table) if isinstance(table, dict) else list(table)
    out[place[0]] = _changed(table[place[0]], place[1:], value)
    return out


def _fits(s, p) -> None:
    """What the search would go on from is of its own shape, and finite."""
    windows = s.train.count + s.held.count
    assert np.isfinite(p.sim.work) and p.sim.work >= 0.0
    for f in (s.resume.fit, *(x.fit for x in s.resume.last)):
        many = len(f.hypothesis.params(p.ctx))
        assert f.theta.shape == f.centre.shape == (many,)
        assert np.isfinite(f.theta).all() and np.isfinite(f.centre).all()
        assert f.information.shape in ((0, 0), (many, many)) and f.cov.shape in ((0, 0), (many, many))
        assert np.isfinite(f.information).all() and np.isfinite(f.cov).all()
    for x in s.resume.last:
        assert (x.train.shape, x.held.shape) == ((s.train.count,), (s.held.count,))
        assert x.each.shape[0] in (0, windows) and np.isfinite([*x.train, *x.held, x.factor]).all()


def test_a_value_of_another_kind_anywhere_is_no_state(kept):
    s, p, path, _ = kept
    table, changed = json.loads(path.read_text()), path.with_name("changed.json")
    # the mark of another search is not looked at; of long lists the first entry stands for all
    first = [x for x in _places(table) if not any(isinstance(k, int) and k > 0 for k in x)]
    places = [x for x in first if x != ("of",)]
    assert len(places) > 40
    for place in places:
        for value in WRONG:
            s.resume, p.sim.work = Reached(), 0.0
            changed.write_text(json.dumps(_changed(table, place, value)))
            checkpoint.attach(s, p, changed)
            try:
                _fits(s, p)
            except AssertionError as error:
                raise AssertionError(f"{place} = {value}") from error


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_what_is_cut_off_or_flipped_is_no_state(kept, data):
    s, p, path, _ = kept
    whole = bytearray(path.read_bytes())
    whole[data.draw(st.integers(0, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    damaged = path.with_name("damaged.json")
    damaged.write_bytes(bytes(whole[: data.draw(st.integers(0, len(whole)))]))
    s.resume, p.sim.work = Reached(), 0.0
    checkpoint.attach(s, p, damaged)
    _fits(s, p)


def test_the_state_of_another_search_is_left_alone(kept, tmp_path):
    s, p, path, _ = kept
    other = tmp_path / "other.json"
    other.write_text(json.dumps({**json.loads(path.read_text()), "of": "something else"}))
    checkpoint.attach(s, p, other)
    assert s.resume == Reached() and p.sim.work == 0.0
