"""Simulations by the engine alone are those with a force of nothing in each step; what diverges is given up."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis.effects.candidates import all_terms, compatible
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis
from mpge_jax.diagnosis.machine.joint_space import difference
from mpge_jax.diagnosis.simulation.batch_simulator import BY_THE_ENGINE, STEP_BY_STEP, Run, Simulator
from mpge_jax.diagnosis.simulation.pushes import Push
from mpge_jax.diagnosis.simulation.windows import Windows
from tests.diagnosis.machines import ARM, BOX, record
from tests.diagnosis.searches import prepared_of


@pytest.fixture(scope="module", params=[ARM, BOX], ids=["arm", "box on a floor"])
def machine(request):
    """A simulator and windows; the same simulator where a load of nothing acts in each step; runs of all effects that
    the engine knows by itself."""
    p = prepared_of(request.param, record(request.param, 1.5, seconds=1.0))
    terms = all_terms(p.ctx)
    load = next(t for t in terms if t.name == "external_force")
    hypotheses = [
        Hypothesis.of(t) for t in terms if t.effect.simulated and compatible(Hypothesis.of(load), t)
    ]
    runs = [Run(h, np.asarray(h.terms[0].effect.starts(p.ctx, h.terms[0].place)[-1])) for h in hypotheses]
    alone = [run for run in runs if p.sim._way(run) == BY_THE_ENGINE]
    assert len(alone) > 8
    stepped = p.sim.beside(Hypothesis.of(load), np.zeros(len(load.effect.starts(p.ctx, load.place)[0])))
    return p.sim, stepped, p.windows("train", p.config.decide_s, 3), alone


def test_a_force_of_nothing_changes_nothing(machine):
    sim, stepped, w, runs = machine
    assert {stepped._way(run) for run in runs} == {STEP_BY_STEP}
    for run, a, b in zip(runs, sim.residuals(runs, w), stepped.residuals(runs, w), strict=True):
        np.testing.assert_array_equal(a, b, err_msg=str(run.hypothesis))


@pytest.mark.parametrize("way", [BY_THE_ENGINE, STEP_BY_STEP])
def test_what_diverges_rests_where_it_began_and_others_go_on(machine, way):
    sim, w, runs = machine[way == STEP_BY_STEP], machine[2], machine[3]
    wild = Run(Hypothesis(), np.zeros(0), push=Push(0, 1e12))
    assert sim._way(wild) == way
    expected = sim.residuals(runs[:2], w)
    fresh = Simulator(sim.model, sim.ctx, always=sim.always)
    first, given_up, last = fresh.residuals([runs[0], wild, runs[1]], w)
    np.testing.assert_array_equal([first, last], expected)
    np.testing.assert_array_equal(given_up, resting(sim, w))


def resting(sim: Simulator, w: Windows) -> np.ndarray:
    """Residuals [W, N, 2 nv] of a machine that stays where it is; their speeds were not measured."""
    m, out = sim.model, np.full((w.count, w.times.shape[1], 2 * sim.model.nv), np.nan)
    start = np.broadcast_to(w.q0[:, None], w.qpos.shape)
    out[..., : m.nv], out[..., m.nv :] = difference(m, start, w.qpos), w.qvel
    out[~w.seen] = np.nan
    return out
