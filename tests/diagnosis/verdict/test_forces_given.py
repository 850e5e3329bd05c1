"""Motion and force without commands, from recordings to the verdict: what was planted in a bench is what is named."""

import dataclasses

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import REGISTRY, Config, Recording
from mpge_jax.diagnosis.dataset.given_motion import EDGE, motion_is_given
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.effects.base import find_place
from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.force_balance import procedure, resolution
from mpge_jax.diagnosis.force_balance.balance import Balance
from mpge_jax.diagnosis.force_balance.low_pass import lagged, low_pass
from mpge_jax.diagnosis.force_balance.needed_force import needed
from mpge_jax.diagnosis.force_balance.resolution import choose
from mpge_jax.diagnosis.force_balance.tracks import Resolution, Track, tracks
from mpge_jax.diagnosis.machine.model import compile_variable
from mpge_jax.diagnosis.report.figures import force_figures
from mpge_jax.diagnosis.report.tables import diagnosis_table, effects_table
from mpge_jax.diagnosis.simulation.single_step import Machine
from mpge_jax.diagnosis.verdict.force_judgement import judge_forces
from tests.diagnosis.machines import ARM, PENDULUM

MOTORS = ARM.replace(
    '<position name="elbow_servo" joint="elbow" kp="8" kv="0.4"/>',
    '<motor name="elbow_motor" joint="elbow"/>',
)
IDS = (
    "coulomb_friction", "viscous_damping", "armature", "actuator_bias", "asymmetric_friction", "quadratic_drag",
    "joint_stiffness", "payload_mass",
)  # fmt: skip


def bench(xml, parts, noise, added=None, seed=0, sensor=np.inf, lag=0.0):
    """Three training recordings and two held-out ones of smooth motion, with the forces that it needs with `parts`:
    [(effect, place, parameters)]; `added(q, v)` acts besides."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(xml)))
    terms = tuple(Term(i, find_place(ctx, REGISTRY[i], at)) for i, at, _ in parts)
    machine = Machine.build(ctx, terms, tuple(np.array(theta, float) for _, _, theta in parts))
    rng, out, t, nv = np.random.default_rng(seed), [], np.arange(0.0, 5.0, 0.01), ctx.model.nv
    for name in ("run_0", "run_1", "run_2", "heldout_0", "heldout_1"):
        w, size = rng.uniform(1.0, 6.0, (3, nv)), rng.uniform(0.15, 0.4, (3, nv))
        angle = t[:, None, None] * w + rng.uniform(0, 6, w.shape)
        q, v, a = ((size * x).sum(1) for x in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))
        track = Track(name, t, q, v, a, np.full_like(v, 1e-4), np.zeros((t.size, ctx.model.nu)))
        force = needed(machine, track)
        force = lagged(low_pass(force if added is None else force + added(q, v), t, sensor), t, lag)
        q = q + 1e-5 * rng.standard_normal(q.shape)
        out.append(Recording(name, t, q, None, None, force + noise * rng.standard_normal(force.shape)))
    return out


def judged(xml, recordings, ids=IDS):
    p = prepare(mujoco.MjSpec.from_string(xml), recordings, Config(jobs=1, effects=ids))
    assert motion_is_given([s.recording for s in p.sources], p.model, p.measured)
    return judge_forces(p, procedure.decide(p, lambda _: None), lambda _: None)


def named(d):
    return {str(t) for t in d.terms}


def test_what_joints_lack_together_and_what_one_lacks_alone_is_named_with_its_size():
    planted = [
        ("coulomb_friction", "shoulder", [0.3]),
        ("coulomb_friction", "elbow", [0.2]),
        ("viscous_damping", "shoulder", [0.15]),
        ("actuator_bias", "elbow_motor", [0.25]),
    ]
    d = judged(MOTORS, bench(MOTORS, planted, 0.02))
    assert d.verdict == "effects" and named(d) == {f"{i}@{at}" for i, at, _ in planted}
    values = {str(t): x for t, x in d.fit.hypothesis.split(d.ctx, d.fit.theta).items()}
    for effect, at, theta in planted:
        np.testing.assert_allclose(values[f"{effect}@{at}"], theta, rtol=0.08)
    held = d.held
    assert held.before > 5 * held.after and 0.7 * held.floor < held.after < 1.5 * held.floor
    assert all(0.05 < x < 1.0 for x in d.error_drop.values())
    # with nothing named, the error is that of the model as given
    alone = max(d.error_drop, key=lambda t: d.error_drop[t])
    assert d.error_drop[alone] < 1 - (held.after / held.before) ** 2
    assert d.location[0][1] == "joint" and d.location[0][2] > 10


@pytest.mark.parametrize("seed", [1, 2])
def test_nothing_is_named_where_nothing_is_missing(seed):
    d = judged(MOTORS, bench(MOTORS, [], 0.05, seed=seed))
    assert (d.verdict, named(d)) == ("none", set())


def test_a_force_that_no_effect_gives_is_unexplained_where_it_acts():
    def odd(q, v):
        return np.stack([0 * q[:, 0], 0.5 * np.sin(9 * q[:, 0]) * np.cos(3 * v[:, 1])], 1)

    d = judged(MOTORS, bench(MOTORS, [("coulomb_friction", "shoulder", [0.3])], 0.02, odd))
    assert d.verdict == "unexplained" and d.unexplained["at"] == ["elbow"] and d.unexplained["of"] == "force"
    assert d.unexplained["share"] > 0.1 and len(d.unexplained["intervals"]) >= 1


def test_what_is_unexplained_is_modelled_as_a_function_that_unseen_forces_follow(tmp_path, monkeypatch):
    def odd(q, v):
        return np.stack([0 * q[:, 0], 0.4 * v[:, 1] * np.cos(3 * q[:, 1])], 1)

    d = judged(MOTORS, bench(MOTORS, [("coulomb_friction", "shoulder", [0.3])], 0.02, odd))
    assert d.verdict == "unexplained" and d.residual.after < 0.5 * d.residual.before == 0.5 * d.held.after
    table = diagnosis_table(d)
    assert table["residual"]["at"] == ["elbow"] and set(table["residual"]["inputs"]) == {"q:elbow", "v:elbow"}
    assert table["residual"]["held_out"]["before"] == table["fit"]["held_out"]["after"]
    assert "modelled all the same" in table["explanation"]
    # whoever rebuilds the machine has it
    (row,) = [e for e in effects_table(d)["effects"] if e["id"] == "residual"]
    assert row["form"] == d.residual.functions[0].term.id and not row["native"]
    assert "coulomb_friction@shoulder" in named(d)
    # and the figure of whole recordings shows what it does
    figures = []
    monkeypatch.setattr(force_figures.drawing, "save", lambda figure, path: figures.append(figure))
    force_figures.whole(d, d.held, tmp_path / "whole.png")
    ax = next(ax for ax in figures[0].axes if ax.get_ylabel().startswith("elbow"))
    measured, _, corrected, modelled = (line.get_ydata() for line in ax.lines)
    assert np.std(modelled - measured) < 0.5 * np.std(corrected - measured)


def test_the_same_in_principle_is_ambiguous():
    """A constant force on a slide: a sensor's zero, or a force from outside."""
    xml = PENDULUM.replace('axis="0 1 0"', 'type="slide" axis="1 0 0"')
    d = judged(
        xml, bench(xml, [("actuator_bias", "motor", [0.3])], 0.01), ("actuator_bias", "external_force")
    )
    assert d.verdict == "ambiguous"
    ((term, rivals),) = d.rivals.items()
    assert {term.id, *(r.term.id for r in rivals if r.tied)} >= {"actuator_bias", "external_force"}


def test_a_filter_is_supposed_only_where_the_force_holds_nothing_above_it():
    friction = [("coulomb_friction", "hinge", [0.3])]

    def chosen(recordings):
        p = prepare(mujoco.MjSpec.from_string(PENDULUM), recordings, Config(jobs=1))
        assert (min(resolution._filters(p)) < 5.0) == (recordings is filtered)
        plain = [Term(i, REGISTRY[i].places(p.ctx)[0]) for i in ("coulomb_friction", "viscous_damping")]
        return choose(p, plain, {})

    filtered = bench(PENDULUM, friction, 1e-5, sensor=2.0)
    assert chosen(bench(PENDULUM, friction, 1e-3)).sensor == np.inf
    assert chosen(filtered).sensor in (1.5, 2.0, 3.0)


@pytest.mark.parametrize("lag", [0.0, 0.02])
def test_forces_that_come_late_are_told_and_what_they_show_keeps_its_size(lag):
    """Late gravity looks like damping, and late inertia like less of it."""
    planted = [
        ("coulomb_friction", "shoulder", [0.3]),
        ("viscous_damping", "elbow", [0.15]),
        ("armature", "shoulder", [0.1]),
    ]
    d = judged(MOTORS, bench(MOTORS, planted, 0.01, lag=lag))
    assert any("come late" in w and "20 ms" in w for w in d.warnings) == (lag > 0.0)
    assert named(d) == {f"{i}@{at}" for i, at, _ in planted}
    values = {str(t): x for t, x in d.fit.hypothesis.split(d.ctx, d.fit.theta).items()}
    for effect, at, theta in planted:
        np.testing.assert_allclose(values[f"{effect}@{at}"], theta, rtol=0.05)


def test_no_lag_is_supposed_of_forces_that_are_rough():
    """Before a lag of 50 ms a force with quick steps would have been far larger than after it."""
    recordings = bench(MOTORS, [("coulomb_friction", "shoulder", [2.0])], 0.01)
    p = prepare(mujoco.MjSpec.from_string(MOTORS), recordings, Config(jobs=1, effects=IDS))
    assert 0.05 not in resolution._lags(p) and resolution._lags(p)[0] == 0.0
    smooth = bench(MOTORS, [], 0.0)
    p = prepare(mujoco.MjSpec.from_string(MOTORS), smooth, Config(jobs=1, effects=IDS))
    assert 0.02 in resolution._lags(p)


def test_motion_below_a_frequency_is_that_of_the_recorded_velocities():
    rng, known = np.random.default_rng(0), []
    for r in bench(PENDULUM, [], 1e-3):
        v = np.gradient(r.qpos, r.time, axis=0)
        known.append(dataclasses.replace(r, qvel=v + 0.02 * rng.standard_normal(v.shape)))
    p = prepare(mujoco.MjSpec.from_string(PENDULUM), known, Config(jobs=1))
    (first, *_), (plain, *_) = (tracks(p, p.train, 10_000, Resolution(motion=m)) for m in (5.0, np.inf))
    assert np.isfinite(p.noise.qvel).all()
    r = p.train[0].recording
    want, rows = low_pass(r.qvel, r.time, 5.0), slice(EDGE, r.time.size - EDGE)
    np.testing.assert_allclose(first.v, want[rows])
    np.testing.assert_allclose(first.a, np.gradient(want, r.time, axis=0)[rows])
    assert not np.allclose(plain.v, first.v)


def test_an_effect_that_helps_by_chance_alone_is_left_out_and_told(monkeypatch):
    recordings = bench(MOTORS, [("coulomb_friction", "shoulder", [0.3])], 0.02)
    p = prepare(mujoco.MjSpec.from_string(MOTORS), recordings, Config(jobs=1, effects=IDS))
    found = procedure.decide(p, lambda _: None)
    chance = Term("armature", find_place(p.ctx, REGISTRY["armature"], "elbow"))
    h = found.fit.hypothesis.with_term(chance)
    parts = {**found.fit.hypothesis.split(p.ctx, found.fit.theta), chance: np.array([0.02])}
    wrong = dataclasses.replace(found.fit, hypothesis=h, theta=h.gather(p.ctx, parts))
    d = judge_forces(p, dataclasses.replace(found, fit=wrong), lambda _: None)
    assert "armature@elbow" not in named(d) and "coulomb_friction@shoulder" in named(d)
    assert any("armature at elbow" in w and "left out" in w for w in d.warnings)


def _goes_and_rests():
    """A pendulum with dry friction of 0.3 N m moves to and fro for 2 s and rests for 4 s, wherever it then is: a
    controller that pushes on holds it with up to 0.25 N m more than its weight needs, and less than friction bears."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    term = Term("coulomb_friction", REGISTRY["coulomb_friction"].places(ctx)[0])
    machine = Machine.build(ctx, (term,), (np.array([0.3]),))
    t, rng, out = np.arange(0.0, 6.0, 0.01), np.random.default_rng(0), []
    for name in ("run_0", "run_1", "run_2", "heldout_0", "heldout_1"):
        moves = t < 2.0
        v = np.where(
            moves, np.sin(np.pi * t / 2) ** 2 * np.sin(rng.uniform(4, 6) * t + rng.uniform(0, 6)), 0.0
        )
        q = rng.uniform(-1, 1) + np.cumsum(v) * 0.01
        q, v, a = q[:, None], v[:, None], np.gradient(v, t)[:, None]
        force = needed(machine, Track(name, t, q, v, a, 0 * v + 1e-4, 0 * v))
        force = force + 0.25 * np.clip(t - 2.0, 0.0, 1.0)[:, None] + 0.01 * rng.standard_normal(v.shape)
        out.append(Recording(name, t, q + 1e-6 * rng.standard_normal(q.shape), None, None, force))
    return out


def test_what_holds_a_joint_at_rest_is_no_bias_of_its_motor():
    d = judged(PENDULUM, _goes_and_rests())
    assert named(d) == {"coulomb_friction@hinge"}
    np.testing.assert_allclose(d.fit.theta, 0.3, rtol=0.03)
    # the error that is reported holds the rows at rest; what is left is told where the joint moves
    assert d.held.after > 0.15 and 0.8 < d.held.each_left[0] / d.held.floors_left[0] < 1.2


def test_a_joint_slides_where_it_moves_at_a_tenth_of_its_usual_speed_and_is_seen_to():
    v = np.array([[0.0], [0.02], [0.05], [-0.11], [1.0]])
    track = Track("r", np.arange(5.0), 0 * v, v, 0 * v, np.full_like(v, 0.01), 0 * v)
    np.testing.assert_array_equal(track.slides(np.array([0.0]))[:, 0], [0, 0, 1, 1, 1])
    np.testing.assert_array_equal(track.slides(np.array([1.0]))[:, 0], [0, 0, 0, 1, 1])
    # and for as long before and after as its acceleration is smoothed over
    np.testing.assert_array_equal(track.slides(np.array([1.0]), about=1.0)[:, 0], [0, 0, 0, 0, 1])
    # of many short recordings one row each may be left
    parts = {f.name: getattr(track, f.name)[-1:] for f in dataclasses.fields(track)}
    alone = Track(**parts | {"name": "r"})
    assert alone.slides(np.array([1.0])).item() and alone.slides(np.array([1.0]), about=1.0).item()


def test_forces_tell_where_their_joint_slides():
    recordings = _goes_and_rests()
    p = prepare(mujoco.MjSpec.from_string(PENDULUM), recordings, Config(jobs=1, effects=IDS))
    b = Balance.recorded(p, p.looked_at, 10**6, Resolution())
    time, v = (np.concatenate([getattr(t, name) for t in b.tracks]) for name in ("time", "v"))
    tells = np.isfinite(b.telling[:, 0])
    assert not tells[time > 2.1].any() and np.isfinite(b.measured).all()
    np.testing.assert_array_equal(tells, np.abs(v[:, 0]) > 0.1 * p.ctx.speed[0])
    # a joint that never slides says all that there is
    still = [dataclasses.replace(t, v=0 * t.v) for t in b.tracks]
    np.testing.assert_array_equal(Balance.of(p.ctx, still, Resolution()).telling, b.measured)


def test_of_two_effects_that_held_out_forces_cannot_tell_apart_both_stay_that_training_needs():
    """Along a motion in one direction a bias is like dry friction: where half of it is gone, it is predicted as well
    without it as with all of it, but not by friction that was fitted alone."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    ids = ("coulomb_friction", "actuator_bias")
    terms = tuple(Term(i, REGISTRY[i].places(ctx)[0]) for i in ids)
    t, rng, out = np.arange(0.0, 6.0, 0.01), np.random.default_rng(0), []
    for name in ("run_0", "run_1", "run_2", "heldout_0", "heldout_1"):
        w, seen = rng.uniform(3.0, 6.0), name.startswith("run")
        v = np.sin(w * t) + 0.4 if seen else 0.3 * np.sin(w * t) - 0.5
        machine = Machine.build(ctx, terms, (np.array([0.4]), np.array([0.3 if seen else 0.15])))
        moved = (rng.uniform(-1, 1) + np.cumsum(v) * 0.01, v, np.gradient(v, t), 0 * v + 1e-4, 0 * v)
        track = Track(name, t, *(x[:, None] for x in moved))
        force = needed(machine, track) + 0.01 * rng.standard_normal(track.v.shape)
        out.append(Recording(name, t, track.q + 1e-6 * rng.standard_normal(track.v.shape), None, None, force))
    d = judged(PENDULUM, out, ids)
    assert named(d) == {"coulomb_friction@hinge", "actuator_bias@motor"}
    np.testing.assert_allclose(d.fit.theta, [0.4, 0.3], rtol=0.05)


def test_masses_that_are_as_inexact_as_they_may_be_are_no_missing_physics():
    spec = mujoco.MjSpec.from_string(MOTORS)
    for k, body in enumerate(b for b in spec.bodies if b.name != "world"):
        for geom in body.geoms:
            geom.mass *= (1.03, 0.97)[k % 2]
    recordings = bench(spec.to_xml(), [], 2e-3)
    d = judged(MOTORS, recordings, (*IDS, "com_offset"))
    assert d.verdict == "none" and not named(d) and d.unexplained is None
    assert d.held.each_left.max() < 1.5 * d.held.floors_left.max()
    assert any(abs(body["mass"]["value"] - 1.0) > 0.02 for body in d.given_inertias)


def test_a_joint_that_trembles_at_rest_is_not_taken_for_one_that_slides():
    """Dry friction that builds up over 0.03 rad/s, along a motion that stops and goes, with a tremble at rest."""
    t, rng, out = np.arange(0.0, 6.0, 0.01), np.random.default_rng(0), []
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    machine = Machine.build(ctx, (), ())
    for k, name in enumerate(("run_0", "run_1", "run_2", "heldout_0")):
        go = np.sin(1.5 * t + k) ** 3 * (np.sin(0.8 * t + k) > 0)
        v = 1.5 * low_pass(go, t, 2.0) + 2e-3 * np.sin(25 * t)
        q = np.cumsum(v) * 0.01
        moved = (q, v, np.gradient(v, t), 0 * v, 0 * v)
        track = Track(name, t, *(x[:, None] for x in moved))
        force = needed(machine, track) + 0.3 * np.tanh(v / 0.03)[:, None]
        q = q[:, None] + 1e-6 * rng.standard_normal((t.size, 1))
        out.append(Recording(name, t, q, None, None, force + 1e-3 * rng.standard_normal(force.shape)))
    p = prepare(mujoco.MjSpec.from_string(PENDULUM), out, Config(jobs=1))
    plain = [Term(i, REGISTRY[i].places(p.ctx)[0]) for i in ("coulomb_friction", "viscous_damping")]
    still = choose(p, plain, {}).still
    assert still >= 0.01
    rows = tracks(p, p.train, 500, Resolution(still=still))
    assert (rows[0].unsure >= still * p.ctx.speed).all()


def test_the_search_ends_where_the_machine_itself_says_that_the_parameters_are():
    """A load is a product of mass and place: as linear near its start, its place would be wrong."""
    load = [0.5, 0.05, 0.0, -0.2]
    recordings = bench(
        MOTORS, [("payload_mass", "fore", load), ("coulomb_friction", "shoulder", [0.3])], 0.01
    )
    ids = ("payload_mass", "coulomb_friction", "viscous_damping", "actuator_bias")
    p = prepare(mujoco.MjSpec.from_string(MOTORS), recordings, Config(jobs=1, effects=ids))
    found = procedure.decide(p, lambda _: None)
    (term,) = (t for t in found.fit.hypothesis.terms if t.place.name == "fore")
    fitted = found.fit.hypothesis.split(p.ctx, found.fit.theta)[term]
    np.testing.assert_allclose(fitted[[0, 3]], [load[0], load[3]], rtol=0.05)
    as_linear = found.search.parts(found.found.best.chosen)[term]
    np.testing.assert_allclose(as_linear, fitted, atol=0.02)


def test_dry_friction_that_sets_in_gradually_is_told_with_its_speed():
    """At both joints as in robot arms; where it does not, beside damping, the plain law stays."""
    size = {"shoulder": (0.3, 0.15), "elbow": (0.1, 0.25)}
    creeps = [("coulomb_friction:gradual", joint, values) for joint, values in size.items()]
    ids = ("coulomb_friction", "viscous_damping", "armature")
    d = judged(MOTORS, bench(MOTORS, creeps, 0.01), ids)
    assert [(t.id, t.place.name) for t in d.terms] == [(form, joint) for form, joint, _ in creeps]
    np.testing.assert_allclose(d.fit.theta, np.concatenate([x for *_, x in creeps]), rtol=0.1)
    assert (
        d.verdict == "effects"
        and diagnosis_table(d)["effects"][0]["parameters"]["velocity"]["unit"] == "rad/s"
    )
    rubs = [(i, joint, (x,)) for joint, (x, _) in size.items() for i in ids[:2]]
    d = judged(MOTORS, bench(MOTORS, rubs, 0.01), ids)
    assert {(t.id, t.place.name) for t in d.terms} == {(i, joint) for i, joint, _ in rubs}


@pytest.mark.parametrize("held", [False, True])
def test_friction_that_holds_a_slow_joint_does_not_set_in_gradually(held):
    """Rows in which a joint hardly slides tell no parameters; but a law that they deny gives way to the plain one."""
    ctx = nominal_context(compile_variable(mujoco.MjSpec.from_string(PENDULUM)))
    plain, creeps = (Term("coulomb_friction" + form, Place("joint", "hinge", 0)) for form in ("", ":gradual"))
    machines = {
        t: Machine.build(ctx, (t,), (np.array(x),)) for t, x in ((plain, [0.3]), (creeps, [0.3, 0.15]))
    }
    t, rng, out = np.arange(0.0, 6.0, 0.01), np.random.default_rng(0), []
    for name in ("run_0", "run_1", "run_2", "heldout_0", "heldout_1"):
        fast = np.clip(2.0 * (3.0 - t), 0.02, 1.0)
        v = (fast * np.sin(rng.uniform(4, 6) * t + rng.uniform(0, 6)))[:, None]
        track = Track(name, t, 0.01 * np.cumsum(v, 0), v, np.gradient(v, t, axis=0), 0 * v + 1e-4, 0 * v)
        force = needed(machines[creeps], track)
        slow = fast[:, None] < 0.05
        force = np.where(slow & held, needed(machines[plain], track), force)
        force = force + 0.01 * rng.standard_normal(v.shape)
        out.append(Recording(name, t, track.q + 1e-6 * rng.standard_normal(v.shape), None, None, force))
    d = judged(PENDULUM, out, ("coulomb_friction", "viscous_damping"))
    assert [x.id for x in d.terms if x.name == "coulomb_friction"] == [plain.id if held else creeps.id]
