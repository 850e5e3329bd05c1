"""How the search decides: evidence, balance, ranks, what is looked at, exchanges, the floor."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording, diagnose
from mpge_jax.diagnosis.dataset.coarse_sampling import is_coarse
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.dataset.prepared import with_drives
from mpge_jax.diagnosis.drives.command_to_force import diagnose_actuators
from mpge_jax.diagnosis.effects.base import Param, Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import _jackknife, evaluate, fit, timing_error
from mpge_jax.diagnosis.estimation.parameter_steps import Problem, beyond
from mpge_jax.diagnosis.estimation.screening import ELABORATE, screen
from mpge_jax.diagnosis.evidence.held_out_error import fit_report, helps
from mpge_jax.diagnosis.evidence.null_distribution import Floor, Left, floor
from mpge_jax.diagnosis.evidence.paired_gains import deviations, rare, stand_out, strong
from mpge_jax.diagnosis.evidence.scored import Scored, clearly_worse, hopeful
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.recordings.recording import validate
from mpge_jax.diagnosis.recordings.states import estimate
from mpge_jax.diagnosis.selection import competition, criteria
from mpge_jax.diagnosis.selection.alternatives import better_rival, find_rivals
from mpge_jax.diagnosis.selection.backward_elimination import final_fit, prune, refined
from mpge_jax.diagnosis.selection.criteria import accept, choose, needed
from mpge_jax.diagnosis.selection.forward_selection import search
from mpge_jax.diagnosis.selection.setup import build_search
from mpge_jax.diagnosis.simulation.batch_simulator import Near, Run
from mpge_jax.diagnosis.simulation.informative_windows import telling_windows
from tests.diagnosis.machines import ARM, BOX, PENDULUM, record

HINGE, MOTOR = Place("joint", "hinge", 0), Place("actuator", "motor", 0)
COULOMB, STRIBECK = Term("coulomb_friction", HINGE), Term("stribeck_friction", HINGE)
DAMPING, GAIN = Term("viscous_damping", HINGE), Term("actuator_gain", MOTOR)
ARMATURE = Term("armature", HINGE)


def search_of(xml: str, recordings: list[Recording]):
    spec = mujoco.MjSpec.from_string(xml)
    plain = compile_variable(spec)
    p = prepare(spec, [validate(r, plain, names_of(plain)) for r in recordings], Config(jobs=1))
    return build_search(p, lambda _text: None, p.config.decide_s), p


def fitted(s, values: dict[Term, list[float]]) -> Fitted:
    h = Hypothesis.of(*values)
    theta = h.gather(s.sim.ctx, {t: np.array(v) for t, v in values.items()})
    return Fitted(h, theta, theta)


@pytest.fixture(scope="module")
def null():
    return search_of(PENDULUM, record(PENDULUM, 0.8))


@pytest.fixture(scope="module")
def rubbing():
    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] = 0.1
        model.dof_solref[0], model.dof_solimp[0] = [-1, -1800], [0.98, 0.99, 0.001, 0.5, 2]

    return search_of(PENDULUM, record(PENDULUM, 0.8, change=change))


def test_an_effect_that_acts_in_few_windows_is_evidence():
    gain = np.zeros(40)
    gain[:5] = [18.7, 18.2, 11.6, 2.3, 1.6]
    assert deviations(gain) < 3 and strong(gain, gain)


def test_one_window_is_no_evidence_and_neither_is_chaos():
    one, chaos = np.zeros(40), np.zeros(40)
    one[0] = 40.0
    chaos[:8] = [20, 15, 10, 5, -4, -6, -8, -3]
    assert not strong(one, one) and not strong(chaos, chaos)


def test_windows_that_stand_out_of_the_noise_are_evidence_for_what_acts_rarely():
    noise = 1.0 + 0.06 * np.random.default_rng(0).standard_normal(77)
    worse = noise.copy()
    worse[[3, 39, 60]] = [2.4, 2.7, 3.0]
    assert set(np.flatnonzero(stand_out(worse))) == {3, 39, 60} and not stand_out(noise).any()
    assert deviations(worse - noise) < 3 and rare(worse, noise, fitted=40)
    # nothing that was not fitted is explained, one of three only, or others are spoiled instead
    assert not rare(worse, np.where(np.arange(77) < 40, noise, worse), fitted=40)
    assert not rare(worse, np.where(np.arange(77) == 60, noise, worse), fitted=40)
    assert not rare(worse, noise + 2.0 * (np.arange(77) % 20 == 5), fitted=40)
    # where much is missing everywhere, large losses are nothing special
    assert not stand_out(5.0 * worse).any() and not rare(5.0 * worse, 5.0 * noise, fitted=40)
    # nor are small ones, or those of a noise that was overestimated
    hardly = np.where(worse > 2, 1.3, 1.0 + 0.001 * noise)
    assert not rare(hardly, np.ones(77), fitted=40) and not rare(0.1 * worse, 0.1 * noise, fitted=40)


def test_what_stands_out_of_a_noise_that_was_enlarged_is_no_evidence(null):
    s, _ = null
    worse = 1.0 + 0.06 * np.random.default_rng(0).standard_normal(77)
    better = worse.copy()
    worse[[3, 39, 60]] = [2.4, 2.7, 3.0]
    old = Scored(NOTHING, worse[:40], worse[40:], 0, 0)
    new = Scored(fitted(s, {COULOMB: [0.1]}), better[:40], better[40:], 1, 1)
    assert needed(new, old) and clearly_worse(old, new)
    tempered = dataclasses.replace(new, factor=3.0)
    assert not needed(tempered, old) and not clearly_worse(old, tempered)


def test_what_scatters_widely_exceeds_the_floor_by_ranks():
    expected = 0.9 + 0.05 * np.random.default_rng(0).standard_normal(32)
    floor_of = Floor(0.9, 0.01, 1.0, expected)
    losses = np.concatenate([np.linspace(0.9, 1.3, 50), np.geomspace(2, 40, 8)])
    assert (losses.mean() - 1.0) < 3.0 * losses.std() / np.sqrt(losses.size)
    assert floor_of.exceeded(losses) and not Floor(0.9, 0.01).exceeded(losses)
    assert not floor_of.exceeded(expected)
    # several windows that no noise explains are not nothing, even if all others are; two may be accidents
    rest = expected[:1].repeat(60)
    assert floor_of.far(np.append(rest, [6.0, 7.0, 20.0])) and not floor_of.far(np.append(rest, [7.0, 20.0]))
    assert not Floor(0.9, 0.01, 1.0, np.array([1.0, 8.0])).far(np.append(rest, [6.0, 7.0, 15.0]))
    # a single window of sixty is none of them
    assert not floor_of.exceeded(np.append(expected[:1].repeat(60) + 0.1, 40.0))


def test_what_one_joint_leaves_does_not_drown_in_what_another_scatters():
    rng = np.random.default_rng(0)
    wild = rng.uniform(1.0, 9.0, (60, 1))
    calm = 0.9 + 0.05 * rng.standard_normal((60, 1))
    losses, typical = 0.5 * (wild + calm)[:, 0], np.ones(60, bool)
    floor_of = Floor(losses.mean(), 0.3, 1.0, losses[:32], np.hstack([wild, calm])[:32])
    assert not floor_of.beyond(Left(losses, np.hstack([wild, calm]), typical))
    # the second joint leaves twice as much as noise would, or much in a few windows
    assert floor_of.beyond(Left(losses, np.hstack([wild, 2 * calm]), typical))
    few = calm.copy()
    few[-6:] = 6.0
    assert floor_of.beyond(Left(losses, np.hstack([wild, few]), np.arange(60) < 50))
    few[-1:] = 1.0
    assert not floor_of.beyond(Left(losses, np.hstack([wild, few]), typical))


def _guess(loss: float, *terms: Term) -> Fitted:
    return Fitted(Hypothesis.of(*terms), np.zeros(0), np.zeros(0), loss)


def test_laws_of_friction_at_one_joint_do_not_crowd_out_what_else_is_hopeful():
    load = Term("load_dependent_friction", HINGE)
    fits = [
        _guess(x, t) for x, t in ((1.0, STRIBECK), (1.1, load), (2.9, COULOMB), (2.8, GAIN), (2.95, ARMATURE))
    ]
    delay, tilt = Term("actuator_delay", MOTOR), Term("gravity_tilt", Place("world", "world", 0))
    fits += [_guess(2.96, delay), _guess(2.97, tilt)]
    # half of what the best takes away, three families, and the plain law of an elaborate one
    kept = [f.hypothesis.terms[0] for f in hopeful(fits, before=3.0)]
    assert kept == [STRIBECK, load, GAIN, COULOMB, ARMATURE]
    assert hopeful([], before=3.0) == []


def test_a_few_wild_windows_do_not_make_a_clear_winner_a_tie():
    good = np.full(60, 1.0)
    worse = good + np.linspace(0.05, 0.4, 60)
    worse[:3] -= (0.0, 4.0, 4.0)
    a, best = (Scored(NOTHING, x[:40], x[40:], 0, 0) for x in (worse, good))
    mean = (worse - good).mean()
    assert 0.03 < mean < 2.0 * (worse - good).std() / np.sqrt(60)
    assert clearly_worse(a, best) and not clearly_worse(best, best)


def test_training_and_held_out_windows_are_tempered_alike():
    s, _ = search_of(PENDULUM, record(PENDULUM, 0.8, lambda m: m.dof_frictionloss.__setitem__(0, 0.1)))
    train, held = s.whiten(NOTHING)
    assert train.factor > 1.5 and held.factor == train.factor
    assert all(white.factor == 1.0 for white in s.whiten(NOTHING, temper=False))


@pytest.fixture(scope="module")
def sliding():
    return search_of(BOX, record(BOX, 6.0))


def test_drag_of_a_body_is_sized_by_how_fast_that_body_moves(sliding):
    s, p = sliding
    speeds = np.concatenate([np.linalg.norm(x.states.qvel, axis=1) for x in p.train_sources])
    assert p.ctx.body_speed[1] == pytest.approx(np.sqrt((speeds**2).mean()), rel=0.15)
    term = next(t for t in s.terms if t.id == "quadratic_drag" and t.place.kind == "body")
    assert term.params(p.ctx)[0].scale == pytest.approx(0.1 * p.ctx.weight / p.ctx.body_speed[1] ** 2)


def test_steps_are_stretched_where_there_are_contacts_alone(sliding, rubbing):
    (s, _), (smooth, _) = sliding, rubbing
    term = next(t for t in s.terms if t.id == "viscous_damping")
    start = fitted(s, {term: [1.0]})
    problem = Problem(start, term.params(s.sim.ctx))
    high = problem.params[0].high
    found = beyond(problem, np.array([1.5]), s.sim.ctx)
    np.testing.assert_allclose(np.ravel(found), np.minimum([2.5, 5.0], high))
    assert beyond(problem, np.array([0.5]), s.sim.ctx)[1] == 0.0
    assert beyond(problem, np.array([1.5]), smooth.sim.ctx) == []


def test_ranks_see_what_spoiled_windows_blur():
    rng = np.random.default_rng(0)
    gain = np.concatenate([rng.uniform(0.1, 0.6, 45), rng.uniform(-0.4, 0, 10), [5, -5, 6, -6, 7, -7]])
    mean = gain.mean() / (gain.std(ddof=1) / np.sqrt(gain.size))
    assert mean < 1.0 and deviations(gain) > 3.0


def test_small_gains_at_the_noise_are_not_needed(null):
    s, _ = null
    old = Scored(fitted(s, {COULOMB: [0.1]}), np.full(40, 1.2), np.full(33, 1.2), 1, 1)
    rng = np.random.default_rng(0)
    better = Scored(
        fitted(s, {COULOMB: [0.1], ARMATURE: [0.001]}),
        old.train - 0.1 + 0.02 * rng.standard_normal(40),
        old.held - 0.1 + 0.02 * rng.standard_normal(33),
        2,
        2,
    )
    assert not needed(better, old)
    assert needed(dataclasses.replace(better, held=better.held - 0.2), old)


def test_windows_in_which_something_happens_are_fitted():
    x = np.ones(200)
    x[[3, 77, 150]] = 40.0
    index, typical = telling_windows(x, 40, np.random.default_rng(0))
    assert index.size == np.unique(index).size == 40 and typical == 27
    assert {3, 77, 150} <= set(index[typical:].tolist())
    assert telling_windows(x[:30], 40, np.random.default_rng(0))[1] == 30


def test_nothing_is_looked_for_at_the_noise(null, monkeypatch):
    s, _ = null

    def never(*_args):
        raise AssertionError("screened although nothing is missing")

    monkeypatch.setattr(competition, "screen", never)
    f, last = search(s)
    assert not f.hypothesis.terms and not last


def test_a_fit_that_names_nothing_gives_way_to_one_that_does(rubbing):
    s, _ = rubbing
    unknown = dataclasses.replace(fitted(s, {STRIBECK: [0.1, 0.1, 0.2]}), cov=np.diag([1e-6, 1.0, 1e-6]))
    known = dataclasses.replace(fitted(s, {COULOMB: [0.1]}), cov=np.diag([1e-6]))
    losses = np.ones(40), np.ones(20)
    ranked = [Scored(unknown, *losses, 1, 1), Scored(known, losses[0] + 0.5, losses[1] + 0.5, 1, 1)]
    assert choose(s, ranked).fit.hypothesis == known.hypothesis


def test_elaborate_friction_is_screened_only_where_plain_friction_helps(null, rubbing):
    for (s, _), expected in ((null, False), (rubbing, True)):
        white = s.whiten_one(NOTHING, s.train)
        found = screen(s.sim, NOTHING, s.terms, *s.sample(NOTHING, white))
        assert any(t.id in ELABORATE for f in found for t in f.hypothesis.terms) == expected


def test_a_start_that_is_far_too_large_does_not_hide_an_effect(rubbing, monkeypatch):
    s, _ = rubbing
    monkeypatch.setattr(type(COULOMB.effect), "starts", lambda *_args: np.array([[1.5]]))
    sample = s.sample(NOTHING, s.whiten_one(NOTHING, s.train))
    (f,) = screen(s.sim, NOTHING, [COULOMB], *sample)
    assert f.theta[0] == pytest.approx(0.1, rel=0.5)


def test_pruning_keeps_what_is_needed_in_its_plainest_form(rubbing):
    s, _ = rubbing
    f, _ = final_fit(s, fitted(s, {STRIBECK: [0.1, 0.1, 0.5], GAIN: [1.0]}))
    assert prune(s, f).hypothesis.terms == (COULOMB,)


def test_a_wrong_term_is_exchanged(rubbing):
    s, _ = rubbing
    f, whites = final_fit(s, fitted(s, {ARMATURE: [0.001]}))
    rivals = find_rivals(s, s.score([f], whites)[0], whites, [])
    better = better_rival(rivals)
    assert better is not None and better.term == COULOMB


def test_the_floor_is_what_a_true_model_leaves():
    """The start is smoothed from the same rows as it is compared with, so its error and theirs are not independent."""
    d = diagnose(mujoco.MjSpec.from_string(PENDULUM), record(PENDULUM, 0.8, noise=1e-3), Config(jobs=1))
    assert d.verdict == "none"
    assert 0.5 < d.held.after.rms / d.held.floor < 1.6


def test_floor_is_lower_than_that_of_independent_errors(null):
    _, p = null
    assert floor(p, NOTHING).ratio < 1.0


def test_actuator_effects_show_in_the_prediction_from_commands():
    gain, recordings = 0.7, []
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    model.opt.timestep /= 4
    rng = np.random.default_rng(0)
    for k in range(4):
        data, rows = mujoco.MjData(model), []
        data.qpos[0] = 0.3 * k
        for i in range(200):
            u = np.sin(0.03 * i * (k + 1)) + 0.4 * np.sign(np.sin(0.11 * i))
            rows.append((0.01 * i, data.qpos[0], u, gain * u))
            data.ctrl[0] = gain * u
            mujoco.mj_step(model, data, 20)
        t, q, u, f = np.array(rows).T
        q = q + 1e-4 * rng.standard_normal(q.size)
        f = f + 1e-3 * rng.standard_normal(f.size)
        recordings.append(Recording(f"run_{k}", t, q[:, None], None, u[:, None], f[:, None]))
    d = diagnose(mujoco.MjSpec.from_string(PENDULUM), recordings, Config(jobs=1))
    found = d.to_json()
    assert [(e["id"], e["at"]) for e in found["effects"]] == [("actuator_gain", "motor")]
    assert d.held.before.rms > 10 * d.held.after.rms


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_back_emf_is_read_from_measured_forces_on_a_jittered_clock(jitter):
    """The command changes at the rows themselves, and the force follows the speed between them."""
    coefficient, recordings = 0.3, []
    rng, plain = np.random.default_rng(0), mujoco.MjModel.from_xml_string(PENDULUM)
    for k in range(3):
        t = np.cumsum(0.01 * (1 + jitter * rng.uniform(-1, 1, 150)))
        q, v = np.sin(3 * t + k), 3 * np.cos(3 * t + k)
        u = np.sin((k + 2) * t) + 0.8 * np.sign(np.sin(25 * t))
        f = u - coefficient * v + 1e-3 * rng.standard_normal(t.size)
        q = q + 1e-4 * rng.standard_normal(t.size)
        recordings.append(Recording(f"run_{k}", t, q[:, None], None, u[:, None], f[:, None]))
    p = search_of(PENDULUM, recordings)[1]
    found = diagnose_actuators(p, plain, ["actuator_gain", "actuator_bias", "actuator_delay", "back_emf"])
    assert [e["id"] for e in found.effects] == ["back_emf"]
    assert found.effects[0]["parameters"]["coefficient"]["value"] == pytest.approx(coefficient, rel=0.02)
    # between rows, the integral of the measured force follows the speed and keeps the steps of the command
    source = with_drives(p, plain, *found.between_rows(plain)).train_sources[0]
    r, steps = source.recording, np.diff(source.recording.time)
    follows = (r.force - r.ctrl)[:, 0]
    mean = r.ctrl[:-1, 0] + 0.5 * (follows[:-1] + follows[1:])
    mean = mean - steps**2 / 12 * source.bend[:, 0]
    assert source.bend.any()
    np.testing.assert_allclose(np.diff(source.integral[:, 0]), steps * mean, atol=1e-4 * steps.mean())


def test_times_are_known_to_a_part_of_a_timestep():
    params = [Param("delay", "s", 0, 1, 0.01), Param("gain", "1", 0, 2, 0.1)]
    np.testing.assert_allclose(timing_error(params, np.array([0.01, 1.0]), 0.002), [0.002 / 12**0.5, 0.0])
    np.testing.assert_allclose(timing_error(params, np.array([0.01, 1.0]), 0.02), [0.001, 0.0])


def test_dense_logs_are_not_coarse_and_undersampled_ones_are():
    def states(amplitude: float, frequency: float) -> bool:
        rng, model = np.random.default_rng(0), mujoco.MjModel.from_xml_string(ARM)
        time = 0.02 * np.arange(400)
        wave = 2 * np.pi * frequency
        q = amplitude * np.sin(wave * time)[:, None] * [1.0, 0.6]
        v = amplitude * wave * np.cos(wave * time)[:, None] * [1.0, 0.6]
        q, v = (x + 1e-3 * rng.standard_normal(x.shape) for x in (q, v))
        r = Recording("r", time, q, v, np.zeros((400, 2)))
        return is_coarse([r], model, estimate([r], model, names_of(model))[0])

    assert not states(0.5, 0.7)
    assert states(0.5, 21.0)


def test_half_a_timestep_is_no_delay(null, monkeypatch):
    s, p = null
    late, dt = Term("sensor_delay", HINGE), float(p.model.opt.timestep)
    monkeypatch.setattr(criteria, "needed", lambda *_: True)
    monkeypatch.setattr(criteria, "named", lambda *_: True)
    old = Scored(NOTHING, np.ones(9), np.full(9, 1.5), 0, 0)
    for steps, loss, accepted in ((0.5, 1.0, False), (1.5, 1.0, True), (0.5, 0.6, True)):
        new = Scored(fitted(s, {late: [steps * dt]}), np.ones(9), np.full(9, loss), 1, 1)
        assert accept(s, new, old) is accepted


def test_what_predicts_held_out_recordings_no_better_is_dropped(rubbing):
    s, p = rubbing
    found = {
        k: fit_report(p, fitted(s, {t: [k]}), held=True)
        for t, k in ((COULOMB, 0.1), (COULOMB, 0.6), (GAIN, 1.5))
    }
    assert {k: helps(report) for k, report in found.items()} == {0.1: True, 0.6: False, 1.5: False}
    assert helps(fit_report(p, NOTHING, held=True))


def test_longer_windows_refine_parameters_and_intervals_hold_the_disagreement(rubbing):
    s, p = rubbing
    longer = p.windows(False, p.config.report_s, 60)
    near, _ = final_fit(s, fitted(s, {COULOMB: [0.1]}))
    agreed = refined(s, near, longer)
    assert agreed.theta[0] == pytest.approx(0.1, rel=0.01)
    # short windows that are sure of 0.13 have a bias, of which the longer ones may keep a third
    biased = dataclasses.replace(near, theta=np.array([0.13]), cov=np.array([[1e-8]]))
    disagreed = refined(s, biased, longer)
    assert disagreed.theta[0] == pytest.approx(0.1, rel=0.01)
    assert disagreed.cov[0, 0] - agreed.cov[0, 0] == pytest.approx((0.03 / 3) ** 2, rel=0.2)
    assert refined(s, NOTHING, longer) is NOTHING


def test_a_machine_without_actuators_is_diagnosed_from_its_swings():
    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] = 0.05
        model.dof_solref[0], model.dof_solimp[0] = [-1, -1800], [0.98, 0.99, 0.001, 0.5, 2]

    xml = PENDULUM[: PENDULUM.index("<actuator>")] + "</mujoco>"
    recordings = [dataclasses.replace(r, ctrl=None) for r in record(xml, 1.0, change=change)]
    d = diagnose(mujoco.MjSpec.from_string(xml), recordings, Config(jobs=1))
    assert d.terms == (COULOMB,)
    assert d.fit.theta[0] == pytest.approx(0.05, rel=0.02)


def test_a_slight_effect_is_found_in_longer_windows():
    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] = 0.005
        model.dof_solref[0], model.dof_solimp[0] = [-1, -1800], [0.98, 0.99, 0.001, 0.5, 2]

    recordings = record(PENDULUM, 0.8, change=change, noise=2e-3, count=8, seconds=4.0)
    d = diagnose(mujoco.MjSpec.from_string(PENDULUM), recordings, Config(jobs=1))
    assert d.terms == (COULOMB,)
    assert d.fit.theta[0] == pytest.approx(0.005, rel=0.1)
    # windows of a quarter second alone do not show it
    again = diagnose(mujoco.MjSpec.from_string(PENDULUM), recordings, Config(jobs=1, report_s=0.25))
    assert again.verdict == "none"


def test_the_number_of_cogs_is_found_from_a_wrong_one():
    periods, amplitude = 30.0, 0.08

    def cogs(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[0] = amplitude * np.sin(periods * data.qpos[0])

    s, p = search_of(PENDULUM, record(PENDULUM, 0.5, force=cogs))
    term = Term("cogging_torque", HINGE)
    travel = float(np.ptp(p.ctx.samples.q[:, 0]))
    middle = float(np.median(p.ctx.samples.q[:, 0]))
    theta = np.array([-0.02, 0.05, periods - 9.0 / travel])
    for a, b, n in term.effect.detours(p.ctx, HINGE, theta):
        torques = [x * np.sin(k * middle) + y * np.cos(k * middle) for x, y, k in (theta, (a, b, n))]
        assert torques[0] == pytest.approx(torques[1])
    start = Fitted(Hypothesis.of(term), theta, theta)
    f = fit(s.sim, [start], s.train, s.whiten_one(start, s.train), iterations=12)[0]
    assert f.theta[2] == pytest.approx(periods, rel=0.01)
    assert np.hypot(*f.theta[:2]) == pytest.approx(amplitude, rel=0.05)


def test_variances_are_those_of_leaving_out_each_window():
    """Linear regression, with one window of much weight that is far off: exact."""
    rng = np.random.default_rng(0)
    windows, samples = 12, 5
    x = rng.standard_normal((windows, samples, 2))
    x[0] *= 5
    y = x @ [1.0, -2.0] + rng.standard_normal((windows, samples)) * np.r_[6.0, np.ones(windows - 1)][:, None]

    def regression(index: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(x[index].reshape(-1, 2), y[index].ravel(), rcond=None)[0]

    everything = np.arange(windows)
    theta = regression(everything)
    moved = np.array([regression(np.delete(everything, k)) for k in everything])
    parts = np.einsum("wmp,wmq->wpq", x, x)
    precision = parts.sum(0)
    # also where the fit stopped before it arrived
    for reached in (theta, theta + np.array([0.5, -0.3])):
        scores = np.einsum("wmp,wm->wp", x, y - x @ reached)
        np.testing.assert_allclose(
            _jackknife(precision, parts, scores, 1 / np.sqrt(np.diag(precision))),
            ((moved - theta) ** 2).sum(0) * (windows - 1) / windows,
        )


def test_intervals_hold_the_truth_as_often_as_they_say():
    """24 intervals of 95 %: that fewer than 20 hold is less likely than 1 in 100."""
    true, held = {COULOMB: 0.1, DAMPING: 0.03}, 0

    def change(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0], model.dof_damping[0] = true[COULOMB], model.dof_damping[0] + true[DAMPING]
        model.dof_solref[0], model.dof_solimp[0] = [-1, -1800], [0.98, 0.99, 0.001, 0.5, 2]

    for seed in range(12):
        s, p = search_of(PENDULUM, record(PENDULUM, 0.8, change=change, noise=1e-3, seed=seed))
        near, _ = final_fit(s, fitted(s, {t: [v] for t, v in true.items()}))
        f = refined(s, near, p.windows(False, p.config.report_s, 60))
        for t, part in zip(f.hypothesis.terms, f.hypothesis.slices(s.sim.ctx), strict=True):
            half = 1.96 * np.sqrt(f.cov[part, part][0, 0])
            held += abs(f.theta[part][0] - true[t]) < half
            assert half < 0.3 * true[t]
    assert held >= 20


def test_runge_kutta_steps_are_told_from_cheaper_ones_and_verified():
    def change(model: mujoco.MjModel) -> None:
        model.dof_damping[0] += 0.03

    s, _ = search_of(PENDULUM.replace("implicitfast", "RK4"), record(PENDULUM, 0.8, change=change))
    known, other = fitted(s, {DAMPING: [0.02]}), fitted(s, {DAMPING: [0.03]})
    runs = [Run(f.hypothesis, f.theta) for f in (known, other)]
    near, exact = Near.to(s.sim, runs[0], s.train).residuals(runs), s.sim.residuals(runs, s.train)
    seen = np.isfinite(exact[0])
    np.testing.assert_allclose(near[0][seen], exact[0][seen], atol=1e-12)
    # the difference between two runs is told far better than a run
    with s.sim.integrator(mujoco.mjtIntegrator.mjINT_EULER):
        alone = s.sim.residuals(runs, s.train)
    wrong = [np.abs(x[1] - exact[1])[seen].max() for x in (near, alone)]
    assert wrong[0] < 0.2 * wrong[1]
    white = s.whiten_one(known, s.train)
    found = fit(s.sim, [known], s.train, white)[0]
    assert found.theta[0] == pytest.approx(0.03, rel=0.02)
    assert found.loss == pytest.approx(evaluate(s.sim, [found], s.train, white)[0].loss, abs=1e-4)
