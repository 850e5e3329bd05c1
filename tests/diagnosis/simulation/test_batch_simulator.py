"""Many runs in one batch: each is what it is by itself."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.candidates import all_terms, compatible
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.effects.inertia.given import given_inertias
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.remembered import Remembered
from mpge_jax.diagnosis.simulation.single_step import Machine
from tests.diagnosis.machines import ARM, record
from tests.diagnosis.searches import prepared_of


@pytest.fixture(scope="module")
def arm():
    p = prepared_of(ARM, record(ARM, [1.5, 0.6], count=4, seconds=1.0))
    terms = [t for t in all_terms(p.ctx) if t.effect.simulated and t.place.index in (0, 1)]
    one_of_each = {t.id: t for t in terms}
    return p.sim, p.windows("train", p.config.decide_s, 2), [*one_of_each.values(), given_inertias(0.03)]


def run_of(sim: Simulator, *terms: Term) -> Run:
    """Every effect as far from nothing as its first guess."""
    h = Hypothesis.of(*terms)
    parts = {t: np.asarray(t.effect.starts(sim.ctx, t.place))[-1] for t in terms}
    for t in terms:
        if not t.effect.named:
            parts[t] = parts[t] + 0.05 * np.arange(parts[t].size)
    return Run(h, h.gather(sim.ctx, parts))


@pytest.fixture(scope="module")
def by_themselves(arm):
    """Pairs of effects, and what each leaves alone."""
    sim, w, terms = arm
    pairs = [run_of(sim, a, b) for a, b in combinations(terms, 2) if compatible(Hypothesis.of(a), b)]
    return pairs, [replace(sim, known=Remembered()).residuals([run], w)[0] for run in pairs]


@pytest.mark.parametrize("way", [1, -1])
def test_a_run_does_not_hang_on_what_else_is_in_the_batch(arm, by_themselves, way):
    sim, w, terms = arm
    alone = [run_of(sim, t) for t in terms[::way]]
    pairs, expected = by_themselves
    assert len(pairs) > 200
    together = replace(sim, known=Remembered()).residuals([*alone, *pairs], w)[len(alone) :]
    for run, told, by_itself in zip(pairs, together, expected, strict=True):
        np.testing.assert_array_equal(told, by_itself, err_msg=str(run.hypothesis))


def test_a_payload_is_added_to_a_mass_that_was_corrected_in_whatever_order_they_are_told(arm):
    sim, _, terms = arm
    payload, given = (next(t for t in terms if t.name == name) for name in ("payload_mass", "given_inertias"))
    parts = {payload: np.array([0.3, 0.0, 0.0, 0.1]), given: np.full(2 * (sim.model.nbody - 1), 1.1)}
    for order in ((payload, given), (given, payload)):
        model = Machine.build(sim.ctx, order, tuple(parts[t] for t in order)).model
        body = payload.place.index
        assert model.body_mass[body] == pytest.approx(1.1 * sim.ctx.model.body_mass[body] + 0.3)
    assert isinstance(model, mujoco.MjModel)
