"""Where motors stand in the gaps of their drives when windows start."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.whitening import robust_loss
from mpge_jax.diagnosis.recordings.recording import Recording
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation import trajectories
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.cheaper_steps import Near
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.remembered import Remembered
from mpge_jax.diagnosis.simulation.run_up import run_up
from tests.diagnosis.machines import FINE_PENDULUM
from tests.diagnosis.searches import search_of

HINGE = Place("joint", "hinge", 0)
GAP = np.array([0.02, 0.2])
BACKLASH, SPRING = Term("backlash", HINGE), Term("joint_flexibility", HINGE)


@pytest.fixture(scope="module")
def chattering() -> Search:
    """A pendulum under stiff position control whose motor strikes both ends of its gap many times a second."""
    entry = {
        "id": "backlash",
        "at": "hinge",
        "kind": "joint",
        "parameters": {"gap": 0.02, "restitution": 0.2},
    }
    corrected = CorrectedModel.build(mujoco.MjSpec.from_string(FINE_PENDULUM), [entry])
    rng, runs = np.random.default_rng(0), []
    for k in range(3):
        stepper, rows = corrected.c_stepper(), []
        stepper.reset(np.zeros(1), np.zeros(1))
        for t in np.arange(400) / 250:
            q = stepper.data.qpos + 2e-4 * rng.standard_normal(1)
            v = stepper.data.qvel + 0.01 * rng.standard_normal(1)
            u = np.clip(20 * (0.4 * np.sin(3 * t + k) - q) - 2 * v, -2, 2)
            rows.append((t, q, u))
            stepper.step(u, 2)
        t, q, u = (np.array(x) for x in zip(*rows, strict=True))
        runs.append(Recording(f"run_{k}", t, q, None, u))
    return search_of(FINE_PENDULUM, runs)[0]


@pytest.fixture
def at_rest(chattering, monkeypatch):
    """Makes motors start pressed to one end of their gaps."""

    def begin() -> None:
        monkeypatch.setattr(trajectories, "run_up", lambda *_: None)
        monkeypatch.setattr(chattering.sim, "known", Remembered())

    yield begin
    chattering.sim.known = Remembered()


def _loss(s: Search) -> float:
    f = Fitted(Hypothesis.of(BACKLASH), GAP, GAP)
    white = s.whiten_one(f, s.train, temper=False)
    return float(
        robust_loss(white.excess(white(s.sim.residuals([Run(f.hypothesis, GAP)], s.train))[0])).mean()
    )


def test_a_motor_in_its_gap_is_where_the_commands_before_the_window_brought_it(chattering, at_rest):
    followed = _loss(chattering)
    at_rest()
    assert followed < 0.6 and _loss(chattering) > 3 * followed


def test_nothing_came_before_the_first_row(chattering, at_rest):
    w, run = chattering.train, Run(Hypothesis.of(BACKLASH), GAP)
    followed = chattering.sim.residuals([run], w)[0]
    at_rest()
    change = np.nanmax(np.abs(followed - chattering.sim.residuals([run], w)[0])[..., 0], axis=1)
    first = w.start == np.array([w.sources[s].recording.time[0] for s in w.source])
    assert first.any() and (change[first] == 0.0).all() and (change[~first] > 0.0).any()


def test_runs_without_gaps_and_other_gaps_do_not_change_a_run(chattering):
    w = chattering.train
    runs = [
        Run(Hypothesis.of(BACKLASH), GAP),
        Run(Hypothesis.of(SPRING), np.array([8.0, 0.2])),
        Run(Hypothesis.of(BACKLASH), 0.5 * GAP),
    ]
    together = chattering.sim.residuals(runs, w)
    for run, expected in zip(runs, together, strict=True):
        chattering.sim.known = Remembered()
        np.testing.assert_array_equal(chattering.sim.residuals([run], w)[0], expected)


def test_memories_of_other_effects_stay_those_of_the_start(chattering, monkeypatch):
    """Those of friction that gives way elastically, in the same run."""
    seen = []

    def watched(batch, model, runtime, *rest) -> None:
        before = [(g.term.id, g.memory) for g in runtime.groups]
        run_up(batch, model, runtime, *rest)
        seen.extend((i, g.memory is m) for g, (i, m) in zip(runtime.groups, before, strict=True))

    monkeypatch.setattr(trajectories, "run_up", watched)
    monkeypatch.setattr(chattering.sim, "known", Remembered())
    elastic = Term("coulomb_friction:elastic", HINGE)
    h, ctx = Hypothesis.of(BACKLASH, elastic), chattering.sim.ctx
    theta = h.gather(ctx, {BACKLASH: GAP, elastic: elastic.effect.starts(ctx, HINGE)[0]})
    chattering.sim.residuals([Run(h, theta)], chattering.train)
    assert dict(seen) == {BACKLASH.id: False, elastic.id: True}


def test_gaps_are_looked_for_in_steps_no_larger_than_the_models(chattering):
    """Larger ones miss what strikes; of finer ones so many are one as make the model's own."""
    w, sim = chattering.train, dataclasses.replace(chattering.sim, stride=4, known=Remembered())
    runs = [Run(Hypothesis.of(BACKLASH), GAP), Run(Hypothesis.of(SPRING), np.array([8.0, 0.2]))]
    assert sim.own_steps(runs, w).tolist() == [True, False]
    assert sim.own_steps(runs, w.refined(2)).tolist() == [True, False]
    fine = w.refined(4)
    assert sim.own_steps(runs, fine).tolist() == [False, False]
    with sim.integrator(mujoco.mjtIntegrator.mjINT_RK4):
        assert sim.own_steps(runs, fine).tolist() == [True, False]
    # what a known run tells of the difference holds for those beside it
    near = Near.to(sim, runs[0], fine)
    np.testing.assert_allclose(near.residuals(runs[:1]), sim.residuals(runs[:1], fine), atol=1e-12)


def test_what_touches_goes_along_and_what_is_apart_does_not():
    """Motors at the upper end, inside, and inside where the link's start lies beyond the gap."""
    theta = np.tile([0.2, 0.3], (3, 1))
    memory = tuple(
        np.array(x) for x in ([1.11, 1.02, 1.05], [2.0, 3.0, 4.0], [9.0] * 3, [9.0] * 3, [9.0] * 3)
    )
    reached, start = (np.full(3, 1.0), np.full(3, 0.5)), (np.array([1.01, 1.01, 1.3]), np.full(3, 0.7))
    (angle, speed, change, farther, before), v = REGISTRY["backlash"].resumed(theta, memory, reached, start)
    np.testing.assert_allclose(angle, [1.12, 1.02, 1.2])
    np.testing.assert_allclose(speed, [2.2, 3.0, 4.0])
    np.testing.assert_allclose(v, [0.7, 0.5, 0.5])
    np.testing.assert_array_equal(before, v)
    assert not change.any() and not farther.any()


def test_the_motion_between_rows_turns_what_floats():
    """A body that spins about an oblique axis while it moves on, and its arm, between rows 0.1 s apart."""
    model = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body><freejoint/><geom size=".1"/>
        <body pos="0 0 .2"><joint name="arm"/><geom size=".1"/></body></body></worldbody></mujoco>""")
    t, spin, glide = np.arange(4) / 10, np.array([0.6, 0.8, 0.0]), np.array([1.0, 2.0, 3.0])

    def state(at: np.ndarray) -> np.ndarray:
        half = at[:, None]
        turn = np.concatenate([np.cos(half), np.sin(half) * spin], 1)
        return np.concatenate([at[:, None] * glide, turn, at[:, None] ** 3], 1)

    v = np.concatenate([np.tile([*glide, *(2 * spin)], (4, 1)), 3 * t[:, None] ** 2], 1)
    recording = Recording("spin", t, state(t), None, np.zeros((4, 0)))
    cov = np.zeros((4, model.nv, 2, 2))
    source = Source.build(recording, States(state(t), v, 0 * v, cov), np.zeros((4, 0)))
    at = np.array([0.03, 0.1, 0.25])
    q, speed = source.motion_at(model, at)
    np.testing.assert_allclose(q, state(at), atol=1e-12)
    np.testing.assert_allclose(speed[:, :6], v[:3, :6], atol=1e-12)
