"""Where fits begin: memories at the start of windows, first guesses, and what makes a guess useless."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest
from scipy.stats import norm

from mpge_jax.diagnosis import Recording, thresholds
from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.dataset.cut_windows import cut
from mpge_jax.diagnosis.effects.angle import waves
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.drive.flexible import JointFlexibility
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation import screening
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import evaluate, fit
from mpge_jax.diagnosis.estimation.parameter_steps import Problem, proposals
from mpge_jax.diagnosis.estimation.screening import _leading, better_beside, screen
from mpge_jax.diagnosis.estimation.whitening import robust_loss
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.selection import criteria
from mpge_jax.diagnosis.selection.search_state import Search
from mpge_jax.diagnosis.simulation import runtime_effects
from mpge_jax.diagnosis.simulation.batch_simulator import MANY_STEPS, Run
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.remembered import Remembered
from mpge_jax.diagnosis.simulation.runtime_effects import Runtime
from tests.diagnosis.machines import ARM, BOX, FINE_PENDULUM, excitation, record
from tests.diagnosis.searches import COULOMB, DAMPING, search_of

HINGE, MOTOR = Place("joint", "hinge", 0), Place("actuator", "motor", 0)
FLEXIBLE = {"stiffness": 8.0, "damping": 0.05}


def _search(xml: str, recordings: list[Recording]) -> Search:
    return search_of(xml, recordings)[0]


def _known(s: Search, term: Term, theta: list[float]) -> Fitted:
    return Fitted(Hypothesis.of(term), np.array(theta), np.array(theta))


def _loss(s: Search, f: Fitted) -> float:
    white = s.whiten_one(f, s.held, temper=False)
    return float(
        robust_loss(white.excess(white(s.sim.residuals([Run(f.hypothesis, f.theta)], s.held))[0])).mean()
    )


@pytest.fixture(scope="module")
def elastic() -> Search:
    """A pendulum whose motor swings behind a soft spring."""
    entry = {"id": "joint_flexibility", "at": "hinge", "kind": "joint", "parameters": FLEXIBLE}
    corrected = CorrectedModel.build(mujoco.MjSpec.from_string(FINE_PENDULUM), [entry])
    rng, runs = np.random.default_rng(0), []
    for k in range(3):
        stepper, rows = corrected.c_stepper(), []
        stepper.reset(np.zeros(1), np.zeros(1))
        for i in range(200):
            u = excitation(k, i / 100, np.array([k]), np.array([0.8]))
            rows.append((i / 100, stepper.data.qpos.copy(), u))
            stepper.step(u, 5)
        t, q, u = (np.array(x) for x in zip(*rows, strict=True))
        runs.append(Recording(f"run_{k}", t, q + 1e-4 * rng.standard_normal(q.shape), None, u))
    return _search(FINE_PENDULUM, runs)


def test_a_motor_behind_a_spring_starts_as_the_recording_left_it(elastic, monkeypatch):
    term = Term("joint_flexibility", HINGE)
    f = _known(elastic, term, list(FLEXIBLE.values()))
    assert _loss(elastic, f) < 1.3
    # at rest in the torque of the moment, as one that was never recorded must be believed to be
    monkeypatch.setattr(JointFlexibility, "fades", lambda _self, _ctx, _place, theta: np.zeros(len(theta)))
    monkeypatch.setattr(elastic.sim, "known", Remembered())
    assert _loss(elastic, f) > 3.0


def test_a_moved_start_moves_the_motion_before_it(elastic, monkeypatch):
    """The angle and speed between motor and link do not change with the link's: windows are moved as a whole."""
    h = Hypothesis.of(Term("joint_flexibility", HINGE))
    w, theta = elastic.train, np.array(list(FLEXIBLE.values()))
    shift = np.tile([0.02, 0.1], (w.count, 1))

    def columns() -> np.ndarray:
        plain, moved = elastic.sim.residuals([Run(h, theta), Run(h, theta, shift)], w)
        return np.nanmax(np.abs((moved - plain)[..., 0]), axis=1)

    followed = columns()
    monkeypatch.setattr(JointFlexibility, "fades", lambda _self, _ctx, _place, theta: np.zeros(len(theta)))
    monkeypatch.setattr(elastic.sim, "known", Remembered())
    # also at a recording's first row, where there is nothing to follow, and shortly after it
    np.testing.assert_allclose(followed, columns(), rtol=0.15)


def test_what_a_run_predicts_does_not_depend_on_its_company(elastic):
    h = Hypothesis.of(Term("joint_flexibility", HINGE))
    quick, slow = (Run(h, np.array([8.0, d])) for d in (0.2, 0.02))
    alone, together = (
        dataclasses.replace(elastic.sim, known=Remembered()).residuals(runs, elastic.train)[0]
        for runs in ([quick], [quick, slow])
    )
    np.testing.assert_array_equal(alone, together)


def test_what_went_before_is_followed_in_no_finer_steps_than_matter(elastic, monkeypatch):
    """In steps of 0.1 ms a motor is followed by the millisecond: that moves no prediction by half of the noise, and
    what one run predicts still does not depend on its company."""
    h, w = Hypothesis.of(Term("joint_flexibility", HINGE)), elastic.train.refined(20)
    quick, slow = (Run(h, np.array([8.0, d])) for d in (0.2, 0.02))

    def predicted(*runs: Run) -> np.ndarray:
        return dataclasses.replace(elastic.sim, known=Remembered()).residuals(list(runs), w)

    observed, inner = [], Runtime._observe
    monkeypatch.setattr(Runtime, "_observe", lambda *a: (observed.append(a[1:]), inner(*a))[1])
    alone = predicted(quick)[0]
    followed = sum(len(args) > 3 for args in observed)
    assert 0 < followed <= 800
    np.testing.assert_array_equal(alone, predicted(quick, slow)[0])
    monkeypatch.setattr(runtime_effects, "STEPS_BEFORE", 10**6)
    observed.clear()
    finer = predicted(quick)[0]
    assert sum(len(args) > 3 for args in observed) >= 8 * followed
    assert 0.0 < np.nanmax(np.abs((finer - alone)[..., 0])) < 0.5e-4


def test_a_gap_ends_what_is_followed(elastic):
    source = elastic.train.sources[0]
    kept = np.r_[0:40, 70 : source.recording.time.size]
    r, s = source.recording, source.states
    recording = Recording("cut", r.time[kept], r.qpos[kept], None, r.ctrl[kept])
    states = States(s.qpos[kept], s.qvel[kept], s.qacc[kept], s.cov[kept])
    w = cut((Source.build(recording, states, source.command[kept]),), elastic.sim.model, elastic.noise,
            0.25, 99, 0.002, np.random.default_rng(0))  # fmt: skip
    _, _, ago = w.before(elastic.sim.model)
    after = w.start > 0.69
    assert after.any() and (ago[after].max(1) == pytest.approx(w.start[after] - 0.7))
    assert ago[~after].max() <= 0.4


def test_motion_before_a_window_ends_where_the_window_starts(elastic):
    w = elastic.train
    q, v, ago = w.before(elastic.sim.model)
    assert q.shape == v.shape == (*ago.shape, 1) and ago.shape == (w.count, w.history)
    # a step before the start, and only what was recorded
    np.testing.assert_allclose(q[:, -1] + w.dt * v[:, -1], w.q0, atol=2e-3)
    first = np.array([w.sources[s].recording.time[0] for s in w.source])
    np.testing.assert_allclose(ago.max(1), np.minimum(w.start - first, w.history * w.dt), atol=1e-9)
    early = int(np.argmin(w.start - first))
    assert (q[early] == w.sources[w.source[early]].states.qpos[0, 0]).all()


def test_soft_and_stiff_springs_are_tried(elastic):
    starts = JointFlexibility().starts(elastic.sim.ctx, HINGE)
    torque = float(elastic.sim.ctx.torque[0])
    # deflections of a radian to a hundredth at the joint's torques
    assert starts[:, 0].min() < 2 * torque and starts[:, 0].max() > 90 * torque


@pytest.mark.parametrize("timestep", ["0.002", "0.02"])
def test_a_delay_within_a_period_is_found_in_coarse_steps_too(timestep):
    """Predictions have a kink at whole periods, and long semi-implicit steps are no Runge-Kutta's."""
    late, rows = 0.012, 0.02
    xml = FINE_PENDULUM.replace('"0.002"', f'"{timestep}"').replace("implicitfast", "RK4")
    rng, runs = np.random.default_rng(0), []
    for k in range(4):
        model = mujoco.MjModel.from_xml_string(xml)
        model.opt.timestep = 0.001
        data, log, before = mujoco.MjData(model), [], np.zeros(1)
        for i in range(100):
            u = excitation(k, i * rows, np.array([k]), np.array([1.0]))
            log.append((i * rows, data.qpos.copy(), u))
            for j in range(20):
                data.ctrl[:] = u if j * 0.001 >= late - 1e-9 else before
                mujoco.mj_step(model, data)
            before = u
        t, q, u = (np.array(x) for x in zip(*log, strict=True))
        runs.append(Recording(f"run_{k}", t, q + 1e-4 * rng.standard_normal(q.shape), None, u))
    s = _search(xml, runs)
    assert s.sim.costly(s.train) == (s.train.steps >= MANY_STEPS) == (timestep == "0.002")
    delay = Term("actuator_delay", MOTOR)
    starts = delay.effect.starts(s.sim.ctx, MOTOR)[:, 0] / rows
    assert (np.abs(starts - np.round(starts)) > 0.2).all() and starts.min() < 1.0
    dense = dataclasses.replace(s.sim.ctx, period=0.001)
    np.testing.assert_allclose(delay.effect.starts(dense, MOTOR)[:, 0], [0.0015, 0.0035, 0.0095])
    (found,) = screen(s.sim, NOTHING, [delay], *s.sample(NOTHING, s.whiten_one(NOTHING, s.train)))
    assert found.theta[0] == pytest.approx(late, abs=0.004)


def test_slopes_are_simulated_where_the_best_starts_are():
    h, losses = Hypothesis.of(DAMPING), [3.0, 1.0, 5.0, 2.0, 4.0]
    problems = [(DAMPING, Problem(Fitted(h, np.zeros(1), np.zeros(1), loss), [])) for loss in losses]
    other = [(COULOMB, Problem(Fitted(h, np.zeros(1), np.zeros(1), 9.0), []))]
    assert [p.fit.loss for _, p in _leading(other + problems)] == [9.0, 3.0, 1.0, 2.0]


def test_sinusoids_are_those_of_least_squares():
    rng = np.random.default_rng(0)
    q, v, weight = rng.uniform(-1, 2, 200), rng.standard_normal(200), rng.uniform(0.3, 1, 200)
    plain = np.stack([np.ones_like(q), q, v, np.sign(v)], 1) * weight[:, None]
    r = weight * (0.3 * np.sin(7.0 * q) - 0.1 * np.cos(7.0 * q) + 0.5 * q - 0.2 * np.sign(v))
    r += 0.01 * rng.standard_normal(200)
    for left, (a, b, n) in waves(np.array([3.0, 7.0]), q, plain, weight, r):
        x = np.concatenate([np.stack([np.sin(n * q), np.cos(n * q)], 1) * weight[:, None], plain], 1)
        expected = np.linalg.lstsq(x, r, rcond=None)[0]
        np.testing.assert_allclose([a, b], expected[:2], rtol=1e-6)
        assert left == pytest.approx(((r - x @ expected) ** 2).sum(), rel=1e-6)


def test_cogs_are_guessed_from_the_missing_torque():
    def cogs(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[0] = 0.06 * np.sin(25.0 * data.qpos[0] + 0.7)

    s = _search(FINE_PENDULUM, record(FINE_PENDULUM, 0.5, force=cogs, noise=1e-5))
    a, b, n = REGISTRY["cogging_torque"].starts(s.sim.ctx, HINGE)[0]
    assert n == pytest.approx(25.0, abs=0.5)
    assert [a, b] == pytest.approx([0.06 * np.cos(0.7), 0.06 * np.sin(0.7)], abs=0.02)


def test_a_wave_is_told_by_its_size_where_its_phase_is_unknown(elastic):
    term = Term("cogging_torque", HINGE)
    wave = np.array([1.0, 1.0]) / np.sqrt(2)
    # one deviation of the phase, a tenth of the size
    cov = np.diag([1.0, 1.0, 1.0])
    cov[:2, :2] = 0.01 * np.outer(wave, wave) + np.outer([wave[1], -wave[0]], [wave[1], -wave[0]])
    f = Fitted(Hypothesis.of(term), np.array([*wave, 9.0]), np.zeros(3), cov=cov)
    # 100 with two degrees of freedom is as unlikely as that
    assert criteria.strength(elastic, f)[term] == pytest.approx(norm.isf(0.5 * np.exp(-50.0)))


@pytest.mark.parametrize(("backward", "named"), [(0.05, False), (0.03, True)])
def test_friction_is_asymmetric_where_its_directions_differ(elastic, backward, named):
    term = Term("asymmetric_friction", HINGE)
    theta = np.array([0.05, backward, 0.01, 0.01])
    f = Fitted(Hypothesis.of(term), theta, theta, cov=1e-6 * np.eye(4))
    assert criteria.named(elastic, f) == named
    if named:
        assert (
            criteria.strength(elastic, f)[term] == pytest.approx(0.02 / np.sqrt(2e-6))
            and thresholds.NAMED < 14
        )


def test_windows_with_steep_slopes_do_not_hold_a_step_back():
    """Three calm windows want the parameter to be 2, seven steep ones nothing but to stay."""
    s = _search(BOX, record(BOX, 6.0, seconds=0.6))
    term = next(t for t in s.terms if t.id == "actuator_gain")
    p = Problem(_known(s, term, [1.0]), term.params(s.sim.ctx))
    slopes = np.array([1.0] * 3 + [300.0] * 7) * 1e3
    p.jacobian = slopes[None, :, None] * np.ones((1, 10, 4))
    p.whitened = np.where(slopes > 2e3, 0.0, -slopes)[:, None] * np.ones((10, 4))
    p.fit = dataclasses.replace(p.fit, x=np.zeros(10))
    assert s.sim.ctx.contacts
    full, damped, calm = (float(theta[0]) for theta in proposals(p, s.sim.ctx))
    assert damped < full < 1.001
    # every window weighs as a calm one
    assert calm == pytest.approx(1.3, abs=0.01)
    without = proposals(p, dataclasses.replace(s.sim.ctx, contacts=()))
    assert [float(theta[0]) for theta in without] == [full, damped]


def test_where_things_touch_chance_is_judged_by_simulation(elastic):
    assert elastic.floor is None
    s = _search(BOX, record(BOX, 6.0, seconds=1.5))
    assert s.floor is not None
    floor = s.floor(NOTHING)
    assert floor.losses.size and 0.3 < floor.loss < 3.0


def test_a_law_of_friction_is_no_worse_in_screening_than_a_plain_one_that_it_contains():
    """Of viscous damping alone, which asymmetric friction begins far from by its own starts."""

    def damped(model: mujoco.MjModel) -> None:
        model.dof_damping[:] += 0.3

    s = _search(FINE_PENDULUM, record(FINE_PENDULUM, [0.5], change=damped, count=4))
    sample = s.sample(NOTHING, s.whiten_one(NOTHING, s.train))
    found = {str(f.hypothesis.terms[0]): f.loss for f in s.screened(NOTHING, sample, s.terms)}
    assert found["asymmetric_friction@hinge"] <= 1.001 * found["viscous_damping@hinge"]
    assert found["viscous_damping@hinge"] < 0.2 * s.score([NOTHING], s.whiten(NOTHING))[0].losses.mean()


def test_a_richer_law_is_looked_at_where_it_promises_more_than_the_plain_one(rubbing):
    """Of a pendulum with plain dry friction, and of one whose friction is 0.15 N m forwards and 0.05 N m backwards."""
    by_direction = Term("asymmetric_friction", HINGE)

    def one_sided(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
        v = float(data.qvel[0])
        data.qfrc_applied[0] -= (0.15 if v > 0 else 0.05) * np.tanh(v / 0.01)

    def begun(s: Search) -> list[Term]:
        white = s.whiten_one(_known(s, COULOMB, [0.1]), s.train)
        plain = fit(s.sim, [_known(s, COULOMB, [0.1])], s.train, white)[0]
        than = evaluate(s.sim, [plain], s.train, white)[0].loss
        known = {COULOMB: plain.theta}
        found = better_beside(s.sim, NOTHING, [by_direction], (s.train, white), {}, than, known)
        return [t for f in found for t in f.hypothesis.terms]

    assert begun(rubbing[0]) == []
    assert begun(_search(FINE_PENDULUM, record(FINE_PENDULUM, 0.8, force=one_sided, seconds=3.0))) == [
        by_direction
    ]


@pytest.mark.parametrize("helped", [(), ("elbow",), ("elbow_servo",), ("elbow", "shoulder_motor")])
def test_gaps_are_looked_for_where_anything_else_helps(monkeypatch, helped):
    s = _search(ARM, record(ARM, [2.0, 1.0], seconds=1.5))
    assert {t.place.name for t in s.terms if t.id == "backlash"} == {"shoulder", "elbow"}
    tried: list[Term] = []

    def quick_fits(_near, base, terms, _white, _own, before, *_known):
        tried.extend(terms)
        worth = {t: 0.5 * before if t.place.name in helped else before for t in terms}
        starts = {t: np.asarray(t.effect.starts(s.sim.ctx, t.place))[0] for t in terms}
        fits = [Fitted(base.hypothesis.with_term(t), x, x) for t, x in starts.items()]
        return [dataclasses.replace(f, loss=worth[t]) for f, t in zip(fits, terms, strict=True)]

    monkeypatch.setattr(screening, "_quick_fits", quick_fits)
    white = s.whiten_one(NOTHING, s.train)
    assert len(screening.screen(s.sim, NOTHING, s.terms, s.train, white)) == len(tried) > 0
    joints = {"elbow_servo": "elbow", "shoulder_motor": "shoulder"}
    found = {t.place.name for t in tried if t.id == "backlash"}
    assert found == {joints.get(name, name) for name in helped}


def test_what_takes_long_is_tried_where_it_helps_most():
    """Of several joints those at which most goes away, and those of which nothing is known."""
    places = [Place("joint", name, k) for k, name in enumerate("abcdef")]
    losses = dict(zip(places, [0.3, 0.1, 0.9, 0.2, 0.4], strict=False))
    terms = [Term("backlash", place) for place in places]
    assert [t.place.name for t in screening._where_it_helps(terms, losses, 0.5)] == ["a", "b", "d", "f"]
    assert [t.place.name for t in screening._where_it_helps(terms, losses, 0.25)] == ["b", "d", "f"]
