"""What the search decides with: forces between rows, starts, small further effects, intervals, the noise floor."""

from __future__ import annotations

import dataclasses
import re

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.dataset import preparation as preparation
from mpge_jax.diagnosis.dataset.informative_windows import SCREEN_WINDOWS, screen_windows
from mpge_jax.diagnosis.effects.base import REGISTRY, Effect
from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.whitening import HOLDING, INTEGRATOR, STEP, numerics, robust_loss, whitener
from mpge_jax.diagnosis.evidence.null_distribution import Floor
from mpge_jax.diagnosis.evidence.numerics_seen import numerics_seen
from mpge_jax.diagnosis.measurement.finer_steps import in_steps_as_seen
from mpge_jax.diagnosis.selection.alternatives import find_rivals
from mpge_jax.diagnosis.selection.backward_elimination import as_wide_as_integrators_differ, final_fit
from mpge_jax.diagnosis.selection.competition import at_floor, at_noise
from mpge_jax.diagnosis.selection.criteria import moves
from mpge_jax.diagnosis.selection.forward_selection import search
from mpge_jax.diagnosis.selection.search_state import MANY, WORK
from mpge_jax.diagnosis.selection.setup import build_search
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.thresholds import AT_NOISE, LOUD
from tests.diagnosis.machines import ARM, FINE_ARM, FINE_PENDULUM, PENDULUM, SERVO, really_sticks, record
from tests.diagnosis.searches import ARMATURE, DAMPING, fitted, prepared_of, search_of


def _search(p):
    return build_search(p, lambda _text: None, p.config.decide_s)


def _losses_seeing_past(s, changes, kind: str) -> list[float]:
    """What the model as given leaves of held-out windows, whitened past all `changes` and past those but one kind."""
    nothing, losses = Run(NOTHING.hypothesis, NOTHING.theta), []
    for nuisance in (changes, {k: x for k, x in changes.items() if k != kind}):
        white = whitener(s.sim, NOTHING.hypothesis, NOTHING.theta, s.held, s.noise, nuisance, temper=False)
        losses.append(robust_loss(white.excess(white(s.sim.residuals([nothing], s.held))[0])).mean())
    return losses


@pytest.mark.parametrize(
    ("name", "theta"), [("actuator_bias:reclipped", [0.5, -1.5, 0.5]), ("actuator_lag", [0.02, 0.3, 0.02])]
)
def test_a_command_over_a_timeline_equals_its_steps(name, theta):
    effect = REGISTRY[name]
    ctx = nominal_context(mujoco.MjModel.from_xml_string(PENDULUM))
    place = Place("actuator", "motor", 0)
    u = np.random.default_rng(0).normal(0, 3, (3, 7))
    each = np.array(theta)[:, None]
    np.testing.assert_allclose(
        effect.timeline(ctx, place, each, u, 0.01), Effect.timeline(effect, ctx, place, each, u, 0.01)
    )


def test_a_lagging_command_at_the_beginnings_of_steps():
    """Of a time constant of a step over log 2, half of the way is gone in each."""
    theta, u = np.array([[0.01 / np.log(2.0)]]), np.array([[1.0, 5.0, 5.0, 1.0, 1.0]])
    lagging = REGISTRY["actuator_lag"].sampled(None, None, theta, u, 0.01)
    np.testing.assert_allclose(lagging, [[1.0, 1.0, 3.0, 4.0, 2.5]])


def test_saturation_is_also_looked_for_near_the_largest_force():
    ctx = nominal_context(mujoco.MjModel.from_xml_string(PENDULUM))
    starts = REGISTRY["torque_saturation"].starts(ctx, Place("actuator", "motor", 0))
    assert starts.max() > 0.95 * ctx.drive[0]


@pytest.fixture(scope="module")
def gained():
    def change(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[:, 0] = 0.7

    return _search(prepared_of(PENDULUM, record(PENDULUM, 0.8, change=change)))


def _with(s, theta: dict[str, float]) -> Fitted:
    places = {"actuator_gain": Place("actuator", "motor", 0), "viscous_damping": Place("joint", "hinge", 0)}
    h = Hypothesis.of(*(Term(i, places[i]) for i in theta))
    values = h.gather(s.sim.ctx, {Term(i, places[i]): np.array([v]) for i, v in theta.items()})
    return Fitted(h, values, values)


def test_a_further_effect_must_move_the_prediction(gained):
    base = _with(gained, {"actuator_gain": 0.7})
    tiny = _with(gained, {"actuator_gain": 0.7, "viscous_damping": 1e-5})
    real = _with(gained, {"actuator_gain": 0.7, "viscous_damping": 0.05})
    assert not moves(gained, tiny, base)
    assert moves(gained, real, base)


def test_work_counts_steps_by_what_they_cost(gained):
    sim, w = dataclasses.replace(gained.sim, work=0.0), gained.held
    sim.residuals([Run(Hypothesis(), np.zeros(0))] * 3, w)
    assert sim.work == 3 * w.count * w.steps
    with sim.integrator(mujoco.mjtIntegrator.mjINT_RK4):
        sim.residuals([Run(Hypothesis(), np.zeros(0))], w)
    assert sim.work == (3 + 4) * w.count * w.steps


def test_fewer_alternatives_are_looked_at_beside_many_terms_or_after_long_work(gained, monkeypatch):
    terms = [Term("actuator_gain", Place("actuator", "motor", k)) for k in range(MANY + 1)]
    for work, brief in ((0.0, (False, False, False, True)), (2 * WORK, (False, False, True, True))):
        monkeypatch.setattr(gained.sim, "work", work)
        assert tuple(gained.brief(Hypothesis.of(*terms[:n])) for n in (0, 1, 2, MANY + 1)) == brief


def test_two_effects_are_found_and_weighed_after_long_work():
    def change(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[0, 0] = 0.7
        model.dof_frictionloss[1] = 0.1

    s = _search(prepared_of(ARM, record(ARM, [2.0, 0.8], change=change)))
    s.sim.work = 2 * WORK
    likely = {
        "actuator_gain",
        "coulomb_friction",
        "viscous_damping",
        "armature",
        "payload_mass",
        "actuator_bias",
    }
    s.terms = [t for t in s.terms if t.name in likely]
    f, last = search(s)
    assert {(t.name, t.place.name) for t in f.hypothesis.terms} == {
        ("actuator_gain", "shoulder_motor"),
        ("coulomb_friction", "elbow"),
    }
    f, whites = final_fit(s, f)
    rivals = find_rivals(s, s.score([f], whites)[0], whites, last)
    assert all(rivals[t] and not any(r.tied or r.better for r in rivals[t]) for t in f.hypothesis.terms)


def test_intervals_allow_for_the_timestep(gained):
    f, _ = final_fit(gained, _with(gained, {"actuator_gain": 0.72}))
    deviation = np.sqrt(f.cov[0, 0])
    assert abs(f.theta[0] - 0.7) < 3 * deviation
    assert deviation < 0.05


def test_a_floating_base_has_sensors_and_air_but_no_friction():
    base = """<mujoco><worldbody><body name="frame"><joint name="x" type="slide" axis="1 0 0"/>
    <joint name="z" type="slide" axis="0 0 1"/><joint name="pitch" axis="0 1 0"/>
    <geom type="box" size=".2 .1 .05" mass="1"/></body></worldbody></mujoco>"""
    ctx = nominal_context(mujoco.MjModel.from_xml_string(base))
    for name in ("sensor_delay", "encoder_offset", "viscous_damping"):
        assert [p.name for p in REGISTRY[name].places(ctx)] == ["x", "z", "pitch"]
    assert not REGISTRY["coulomb_friction"].places(ctx)


def test_screening_looks_where_something_happens():
    x = np.ones(40)
    x[[7, 19, 33]] = 50.0
    index = screen_windows(x, np.random.default_rng(0))
    assert {7, 19, 33} <= set(index.tolist())
    assert len(set(index.tolist())) == SCREEN_WINDOWS


STIFF = SERVO.replace('kp="20"', 'kp="80" kv="2" forcerange="-1.5 1.5"').replace(
    'timestep="0.002"', 'timestep="0.004"'
)


def test_what_a_coarse_timestep_gets_wrong_is_noise_where_it_is_not_linear():
    """A servo that saturates, recorded from four times finer steps, lacks nothing."""
    p = prepared_of(STIFF, record(STIFF, 0.8, noise=1e-5))
    s = _search(p)
    residual = p.sim.residuals([Run(NOTHING.hypothesis, NOTHING.theta)], s.held)
    around = (p.sim, NOTHING.hypothesis, NOTHING.theta, s.held, p.noise)
    plain = whitener(*around, temper=False)
    white = s.whiten_one(NOTHING, s.held, temper=False)
    loss = [robust_loss(w.excess(w(residual))[0]).mean() for w in (plain, white)]
    assert loss[0] > 5.0 and loss[1] < 1.5
    assert (
        white.scale.shape == residual.shape[1:]
        and (white.take(np.array([0, 2])).scale == white.scale[[0, 2]]).all()
    )


PENDULUMS = "".join(
    f"""<body pos="0 {k} 0"><joint name="j{k}" axis="0 1 0" damping="0.02" armature="0.004"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5" contype="0" conaffinity="0"/></body>"""
    for k in range(16)
)
MOTORS = "".join(f'<motor joint="j{k}"/>' for k in range(16))
PENDULA = f"""<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>{PENDULUMS}</worldbody>
<actuator>{MOTORS}</actuator></mujoco>"""


@pytest.mark.parametrize("known", [0.0, 0.02])
@pytest.mark.parametrize("lacking", [0.0, 0.002])
def test_what_one_of_many_joints_lacks_does_not_drown(lacking, known):
    """Also where dry friction of another joint was found before."""

    def change(model: mujoco.MjModel) -> None:
        model.dof_damping[3] += lacking
        model.dof_frictionloss[7] += known

    s = _search(prepared_of(PENDULA, record(PENDULA, 0.8, change=change, noise=1e-3)))
    rubs = Term("coulomb_friction", Place("joint", "j7", 7))
    base = fitted(s, {rubs: [known]}) if known else NOTHING
    white = s.whiten_one(base, s.train)
    flat = white(s.sim.residuals([Run(base.hypothesis, base.theta)], s.train))[0]
    each = robust_loss(white.by_dof(flat, 16)).mean(0)
    assert robust_loss(white.excess(flat)).mean() < AT_NOISE and white.factor == 1.0
    assert (np.flatnonzero(each > LOUD) == ([3] if lacking else [])).all()
    assert at_noise(s, base, white) == (not lacking)


def test_what_one_joint_lacks_does_not_drown_in_what_noise_leaves_of_all(monkeypatch):
    """Where noise enters otherwise than through measurements, by what the truth would leave of each joint."""
    floor = Floor(loss=1.5, error=0.01, losses=np.full(40, 1.5), by_dof=np.array([0.5, 2.0]))
    assert floor.loud(np.array([1.4, 2.9])).tolist() == [False, False]
    assert floor.loud(np.array([1.6, 3.1])).tolist() == [True, True]
    s = _search(prepared_of(ARM, record(ARM, [4.0, 0.8], noise=1e-4)))
    s.floor = lambda _f: floor
    base = fitted(s, {Term("viscous_damping", Place("joint", "elbow", 1)): [0.0]})
    assert at_floor(s, base)
    monkeypatch.setattr(Floor, "loud", lambda _self, by_dof: np.arange(by_dof.size) == 1)
    assert not at_floor(s, base)


def test_explicit_and_implicit_steps_of_a_stiff_servo_differ_by_no_physics():
    """MuJoCo's Euler takes a servo's damping at the old speed, implicitfast at the new one."""
    stiff = FINE_ARM.replace('kp="8" kv="0.4"', 'kp="60" kv="1.5"')
    explicit = stiff.replace('"implicitfast"', '"Euler"').replace('"0.002"', '"0.004"')
    s = _search(prepared_of(stiff, record(explicit, 0.8, noise=3e-6)))
    changes = numerics(s.sim, NOTHING.hypothesis, NOTHING.theta, s.held)
    losses = _losses_seeing_past(s, changes, INTEGRATOR)
    assert losses[0] < 1.1 < 1.4 < losses[1]
    assert s.sim.model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


def test_rotor_inertia_lies_within_what_implicit_damping_adds_to_it():
    """MuJoCo's implicit steps add a step's damping to an inertia: 0.005 s of 0.4 N m s/rad to 0.04 kg m^2; a machine
    that is no program has half of that."""
    inertia, damping = 0.04, 0.4

    def change(model: mujoco.MjModel) -> None:
        model.dof_armature[0] += inertia

    def brake(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[0] -= damping * data.qvel[0]

    s, _ = search_of(PENDULUM, record(PENDULUM, 3.0, change=change, force=brake, noise=1e-5, seconds=4.0))
    f, _ = final_fit(s, fitted(s, {ARMATURE: [inertia], DAMPING: [damping]}))
    wide = as_wide_as_integrators_differ(s, f, s.train)
    k = f.hypothesis.slices(s.sim.ctx)[f.hypothesis.terms.index(ARMATURE)].start
    assert abs(wide.theta[k] - inertia) < 2.0 * np.sqrt(wide.cov[k, k]) < 0.1 * inertia


def test_given_friction_that_holds_where_mujocos_creeps_is_no_physics():
    rubs = FINE_ARM.replace('name="shoulder" axis', 'name="shoulder" frictionloss="0.3" axis')
    p = prepared_of(rubs, record(rubs, [1.0, 0.8], change=lambda m: really_sticks(m, 0), noise=1e-5))
    s = _search(p)
    changes = numerics(s.sim, NOTHING.hypothesis, NOTHING.theta, s.held)
    losses = _losses_seeing_past(s, changes, HOLDING)
    assert losses[0] < 1.2 < 2.0 < losses[1]
    # the engine's own friction that holds is as the machine's
    amounts, told = numerics_seen(p, NOTHING)
    assert amounts[HOLDING] == pytest.approx(1.0, abs=0.15)
    assert any("holds otherwise than MuJoCo's" in x for x in told)
    # where more friction is found, its law is that of both
    rubbing = fitted(s, {Term("coulomb_friction", Place("joint", "shoulder", 0)): [0.1]})
    assert HOLDING not in numerics(s.sim, rubbing.hypothesis, rubbing.theta, s.held)


def test_commands_that_act_within_a_timestep_are_told_with_their_delay():
    """The machine obeys a millisecond late, half of the model's timestep: two of the steps that it is simulated in."""
    held: list[np.ndarray] = []

    def late(_model: mujoco.MjModel, data: mujoco.MjData) -> None:
        held[:] = [data.ctrl.copy() for _ in range(3)] if data.time == 0.0 else [*held[1:], data.ctrl.copy()]
        data.ctrl[:] = held[0]

    p = prepared_of(FINE_PENDULUM, record(FINE_PENDULUM, 0.8, force=late, noise=1e-5))
    told = numerics_seen(p, NOTHING)[1][-1]
    by = re.match(
        r"all commands act later than the model has it by (\S+) ms, as with a delay common to all", told
    )
    assert by is not None and float(by[1]) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(("timestep", "warned"), [("0.002", True), ("0.008", False)])
def test_a_finer_timestep_is_told_with_its_size(timestep, warned):
    """Recordings are made with a quarter of the timestep."""
    p = prepared_of(FINE_PENDULUM, record(FINE_PENDULUM.replace("0.002", timestep), 0.8, noise=1e-5))
    amounts, told = numerics_seen(p, NOTHING)
    assert any("move as with a finer timestep" in x for x in told) == (STEP in amounts) == warned
    assert not any("act later" in x for x in told)
    # halving the timestep is two thirds of the way to a quarter
    assert not warned or amounts[STEP] == pytest.approx(1.5, rel=0.1)
    # all is simulated in such steps, and that is said once
    seen = in_steps_as_seen(p)
    assert seen.dt == (p.dt / 4 if warned else p.dt) and (seen is p) == (not warned)
    assert [x for x in p.warnings if "finer timestep" in x] == [x for x in p.warnings if "in steps of" in x]
    assert (
        not any("finer timestep" in x for x in numerics_seen(seen, NOTHING)[1]) and len(p.warnings) == warned
    )
