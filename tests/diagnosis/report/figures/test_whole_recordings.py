"""Whole held-out recordings are predicted from their start; where rows were lost, the longest stretch without a gap."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.report.figures import whole_recordings as whole
from mpge_jax.diagnosis.report.figures.whole_recordings import RECORDINGS, whole_recordings
from mpge_jax.diagnosis.residual.model import Function, ResidualModel
from tests.diagnosis.machines import FINE_PENDULUM, record
from tests.diagnosis.searches import COULOMB, HINGE, fitted, prepared_of

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
    runs = record(FINE_PENDULUM, 1.2, force=_slowed, count=8, seconds=2.0)
    names = [r.name if k < 3 else f"heldout_{k}" for k, r in enumerate(runs)]
    runs = [replace(r, name=name) for r, name in zip(runs, names, strict=True)]
    runs[4] = _with_a_gap(runs[4])
    p = prepared_of(FINE_PENDULUM, runs)
    f = fitted(SimpleNamespace(sim=p.sim), {COULOMB: [FRICTION]})
    return SimpleNamespace(prepared=p, fit=f, terms=f.hypothesis.terms, residual=None)


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
    plain = SimpleNamespace(prepared=diagnosed.prepared, fit=None, terms=(), residual=None)
    assert all(one.after is one.before and one.modelled is None for one in whole_recordings(plain))


def test_with_what_is_left_as_a_function_there_is_one_more_prediction(diagnosed):
    """Dry friction as a function of the speed, in place of the effect."""
    effect = Residual((Axis("v", -4.0, 4.0),), 4.0)
    seen = np.linspace(-4.0, 4.0, 200)
    theta = np.linalg.lstsq(np.array(effect.basis(np, [seen])).T, -FRICTION * np.sign(seen), rcond=None)[0]
    model = ResidualModel((Function(Term(effect.id, HINGE), theta, None),), 1.0, 0.5)
    d = SimpleNamespace(prepared=diagnosed.prepared, fit=NOTHING, terms=(), residual=model)
    for one in whole_recordings(d):
        assert one.after is one.before and one.modelled.rms < 0.5 * one.before.rms


def test_gaps_are_told_and_parts_of_logs_are_no_gaps(diagnosed):
    def title(one):
        return whole._title(one.windows.sources[0], one.windows)

    first, second, _ = whole_recordings(diagnosed)
    assert title(first) == "heldout_3" and re.fullmatch(r"heldout_4, 0\.\d+ to 2 s", title(second))
    p = prepared_of(FINE_PENDULUM, record(FINE_PENDULUM, 1.2, force=_slowed, count=2, seconds=2.0))
    d = SimpleNamespace(prepared=p, fit=None, terms=(), residual=None)
    assert [title(one) for one in whole_recordings(d)] == ["run_0_test", "run_1_test"]
