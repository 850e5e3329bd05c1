"""Whole held-out recordings are predicted from their start; where rows were lost, the longest stretch without a gap."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mpge_jax.diagnosis.report.figures.whole_recordings import RECORDINGS, whole_recordings
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import COULOMB, fitted, prepared_of

FRICTION = 0.1


def _slowed(_model, data):
    data.qfrc_applied[0] = -FRICTION * np.tanh(data.qvel[0] / 0.03)


def _with_a_gap(r):
    """Rows of the first 0.5 s, and those from 0.8 s on."""
    kept = (r.time < 0.5) | (r.time > 0.8)
    return replace(r, time=r.time[kept], qpos=r.qpos[kept], ctrl=r.ctrl[kept])


@pytest.fixture(scope="module")
def diagnosed():
    """A pendulum with dry friction, its right value, and five held-out recordings of which the second has a gap."""
    runs = record(PENDULUM, 1.2, force=_slowed, count=8, seconds=2.0)
    names = [r.name if k < 3 else f"heldout_{k}" for k, r in enumerate(runs)]
    runs = [replace(r, name=name) for r, name in zip(runs, names, strict=True)]
    runs[4] = _with_a_gap(runs[4])
    p = prepared_of(PENDULUM, runs)
    f = fitted(SimpleNamespace(sim=p.sim), {COULOMB: [FRICTION]})
    return SimpleNamespace(prepared=p, fit=f, terms=f.hypothesis.terms)


def test_whole_recordings_are_predicted_by_either_model(diagnosed):
    shown = whole_recordings(diagnosed)
    assert len(shown) == RECORDINGS
    lasts = [float(one.windows.start[0] + one.windows.times.max()) for one in shown]
    assert lasts == pytest.approx([2.0] * RECORDINGS, abs=0.02)
    starts = [float(one.windows.start[0]) for one in shown]
    # the second one begins after its gap
    assert starts[1] == pytest.approx(0.81, abs=0.1) and max(starts[0], starts[2]) < 0.2
    for one in shown:
        assert one.windows.count == 1
        assert one.before.rms > 10 * one.after.rms


def test_without_effects_there_is_one_prediction(diagnosed):
    plain = SimpleNamespace(prepared=diagnosed.prepared, fit=None, terms=())
    assert all(one.after is one.before for one in whole_recordings(plain))
