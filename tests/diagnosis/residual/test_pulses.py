"""What pulses of force do to windows says what functions do that act there, without simulating these."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.effects.residual.axis import Axis
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.residual.inputs import functions, seen, values_of, values_within
from mpge_jax.diagnosis.residual.model import with_function
from mpge_jax.diagnosis.residual.pulses import Pulses
from mpge_jax.diagnosis.residual.regression import smoothed
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from tests.diagnosis.searches import COULOMB, HINGE, fitted


@pytest.fixture(scope="module")
def told(rubbing):
    """Windows of the pendulum, which its model predicts once it rubs; their answers; a whitener; what simulates."""
    s, p = rubbing
    f = fitted(s, {COULOMB: [0.1]})
    w = p.windows("train", p.config.decide_s, 40, seed=17)
    white = s.whiten_one(f, w)
    return p, f, w, white, Pulses.at(p, f, HINGE, w)


@pytest.mark.parametrize(
    "inputs", [("q",), ("v",), ("f",), ("q", "v"), ("dry", "q"), ("z",)], ids=lambda x: " ".join(x)
)
def test_functions_do_what_the_pulses_say(told, inputs):
    p, f, w, white, pulses = told
    want = tuple(x for x in inputs if x != "dry"), "dry" in inputs
    effect = [e for e in functions(seen(p, HINGE), True) if (tuple(a.input for a in e.axes), e.dry) == want][
        -1
    ]
    term, rng = Term(effect.id, HINGE), np.random.default_rng(0)
    theta = 1e-3 * rng.standard_normal(effect.size)
    runs = [Run(g.hypothesis, g.theta) for g in (f, with_function(p.ctx, f, term, theta))]
    left, changed = white(p.sim.residuals(runs, w))
    problem = pulses.seen_by(white, np.ones(w.count)).of(effect)
    np.testing.assert_allclose(problem.whole, (left**2).sum(-1))
    # what is left as these values change it, with the least squares' help: ||r + A x||^2
    moved = changed - left
    gram, push = problem.summed()
    assert theta @ gram @ theta == pytest.approx((moved**2).sum(), rel=0.15)
    most = np.sqrt((moved**2).sum() * (left**2).sum())
    assert theta @ push == pytest.approx((moved * left).sum(), abs=0.1 * most)


def test_inputs_within_windows_are_those_of_the_recording(told):
    p, _, w, _, _ = told
    times = w.times[0][w.seen[0]]
    within = values_within(p, w, HINGE, times)
    assert within.keys() == seen(p, HINGE).keys()
    known = values_of(p, w.sources[w.source[0]], HINGE)
    rows = np.searchsorted(w.sources[w.source[0]].recording.time, w.start[0] + times - 1e-9)
    for key in ("q", "v", "l", *(k for k in known if k.startswith("z"))):
        np.testing.assert_allclose(within[key][0], known[key][rows], atol=1e-6, err_msg=key)
    # a command is told by the step in which it acts
    assert np.corrcoef(within["f"][0], known["f"][rows])[0, 1] > 0.99


def test_every_function_can_be_told(told):
    p, _, w, white, pulses = told
    answers = pulses.seen_by(white, np.ones(w.count))
    for effect in functions(seen(p, HINGE), True):
        gram, push = answers.of(effect).summed()
        assert (
            gram.shape == (effect.size, effect.size) and np.isfinite(push).all() and np.abs(gram).max() > 0.0
        )


def test_what_a_fit_leaves_is_told(told):
    """Beside dry friction that is right next to nothing, and without it what is like that."""
    p, _, w, white, pulses = told
    effect, fold = Residual((Axis("v", -6.0, 6.0),), 9.0), np.arange(w.count) % 5
    sizes = []
    for these in (pulses, Pulses.at(p, NOTHING, HINGE, w)):
        found = smoothed(effect, HINGE.index, these.seen_by(white, np.ones(w.count)).of(effect), fold)
        sizes.append(effect.value(np, found.values, [np.array([-3.0, 3.0])]))
    assert np.abs(sizes[0]).max() < 0.02
    np.testing.assert_allclose(sizes[1], [0.1, -0.1], atol=0.03)
