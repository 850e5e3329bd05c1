"""Machines driven by the forces that were measured on them: what happens between rows, and what noise does to them."""

import dataclasses
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.dataset.prepared import Prepared, with_drives
from mpge_jax.diagnosis.drives.command_to_force import ActuatorSide, diagnose_actuators
from mpge_jax.diagnosis.drives.drive_law import Data, Log, predict
from mpge_jax.diagnosis.drives.drive_remainder import unexplained_drive
from mpge_jax.diagnosis.drives.driven_machine import as_encoders_read
from mpge_jax.diagnosis.drives.law_search import search_law
from mpge_jax.diagnosis.effects.base import REGISTRY
from mpge_jax.diagnosis.effects.context import Place, nominal_context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.levenberg_marquardt import fit
from mpge_jax.diagnosis.estimation.prediction_error import noise_floor
from mpge_jax.diagnosis.evidence.held_out_error import fit_report
from mpge_jax.diagnosis.evidence.null_distribution import Floor, floor, force_noise
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.measurement.encoder_zeros import with_zeros
from mpge_jax.diagnosis.measurement.measurement_model import MeasurementModel
from mpge_jax.diagnosis.measurement.servo_force_age import age_of, aged, describe_age, other_age, staleness
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.recordings.validation import validate
from mpge_jax.diagnosis.selection import setup
from mpge_jax.diagnosis.selection.procedure import what_is_left
from mpge_jax.diagnosis.selection.remainder import leaves
from mpge_jax.diagnosis.simulation.driving.force_between_rows import servo_jumps
from mpge_jax.diagnosis.simulation.driving.measured_drives import plain_force
from tests.diagnosis.machines import excitation
from tests.diagnosis.searches import search_of

SERVO = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="arm">
<joint name="hinge" axis="0 1 0" damping="0.02" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5" contype="0" conaffinity="0"/></body></worldbody>
<actuator><position name="servo" joint="hinge" gear="2" kp="5" kv="0.2" ctrlrange="-2 2" forcerange="-4 4"/></actuator>
</mujoco>"""


MOTOR = """<mujoco><worldbody><body><joint name="hinge"/><geom size=".1"/></body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""


def _states(q: np.ndarray, v: np.ndarray) -> States:
    return States(q[:, None], v[:, None], 0 * q[:, None], np.zeros((q.size, 1, 2, 2)))


def test_a_servos_force_jumps_with_its_command_up_to_its_limits():
    model = mujoco.MjModel.from_xml_string(SERVO)
    q, v = np.zeros(5), np.array([0.0, 0.0, 0.0, 1.0, 1.0])
    # force 5 (u - 2 q) - 0.2 * 2 v within +-4, command within +-2
    u = np.array([0.0, 0.2, 1.0, 1.0, 3.0])
    r = Recording("r", 0.01 * np.arange(5), q[:, None], None, u[:, None], u[:, None])
    np.testing.assert_allclose(
        servo_jumps(r, _states(q, v), model)[:, 0], [0.0, 1.0, 3.0, 0.0, 0.0], atol=1e-12
    )
    v[4] = 5.0  # braked by 2: from 3 to the limit of 4
    np.testing.assert_allclose(servo_jumps(r, _states(q, v), model)[4, 0], 4.0 - 3.0)
    without = Recording("r", r.time, r.qpos, None, None, r.force)
    assert not servo_jumps(without, _states(q, v), model).any()


def _driven(noise: float, rate: int = 100, gain: float = 1.0, count: int = 4) -> list[Recording]:
    """A servo that follows its command, with the force that it gives just after every row."""
    rng, out = np.random.default_rng(0), []
    model = mujoco.MjModel.from_xml_string(SERVO)
    model.opt.timestep = 0.0005
    model.actuator_gainprm[0, 0] *= gain
    model.actuator_biasprm[0, :3] *= gain
    for k in range(count):
        data, rows = mujoco.MjData(model), []
        for i in range(3 * rate + 1):
            u = excitation(k % 2 * 2, i / rate, np.array([k]), np.array([0.8]))
            data.ctrl[:] = u
            mujoco.mj_forward(model, data)
            rows.append((i / rate, data.qpos.copy(), u, data.actuator_force.copy()))
            mujoco.mj_step(model, data, 2000 // rate)
        time, q, u, f = (np.array(x) for x in zip(*rows, strict=True))
        q = q + 1e-5 * rng.standard_normal(q.shape)
        out.append(Recording(f"run_{k}", time, q, None, u, f + noise * rng.standard_normal(f.shape)))
    return out


def _search(recordings: list[Recording]):
    return search_of(SERVO, recordings)[::-1]


def test_a_servo_that_is_as_modelled_seems_to_lack_no_damping():
    _, s = _search(_driven(0.0))
    term = next(t for t in s.terms if t.id == "viscous_damping")
    h = Hypothesis.of(term)
    start = Fitted(h, np.array([0.01]), np.array([0.01]))
    found = fit(s.sim, [start], s.train, s.whiten_one(NOTHING, s.train))[0]
    # 0.1 where the servo is believed to know its next command (gear^2 kp times half a row)
    assert abs(found.theta[0]) < 0.01


def _servos(step: float, lack: np.ndarray) -> tuple[Prepared, mujoco.MjModel]:
    """Four pendulums with servos that compute every `step`, which have `lack` [4] more damping than their model."""
    joint = """<body name="{0}" pos="{1} 0 0"><joint name="j{0}" axis="0 1 0" damping="0.02" armature="0.01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5" contype="0" conaffinity="0"/></body>"""
    servo = '<position name="s{0}" joint="j{0}" kp="{1}" kv="0.3"/>'
    xml = f"""<mujoco><option timestep="0.0005" integrator="implicitfast"/><worldbody>
    {"".join(joint.format(k, k) for k in range(4))}</worldbody><actuator>
    {"".join(servo.format(k, 4 + 2 * k) for k in range(4))}</actuator></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.timestep, model.opt.integrator = step, mujoco.mjtIntegrator.mjINT_EULER
    model.dof_damping[:] += lack
    rng, recordings = np.random.default_rng(0), []
    for k in range(3):
        data, rows = mujoco.MjData(model), []
        for i in range(400):
            data.ctrl[:] = u = excitation(k % 2 * 2, i / 100, np.arange(4) + k, np.full(4, 0.8))
            mujoco.mj_forward(model, data)
            rows.append((i / 100, data.qpos.copy(), u, data.actuator_force.copy()))
            mujoco.mj_step(model, data, round(0.01 / step))
        time, q, u, force = (np.array(x) for x in zip(*rows, strict=True))
        recordings.append(
            Recording(f"run_{k}", time, q + 1e-5 * rng.standard_normal(q.shape), None, u, force)
        )
    spec = mujoco.MjSpec.from_string(xml)
    plain = compile_variable(spec)
    p = prepare(spec, [validate(r, plain, names_of(plain)) for r in recordings], Config(jobs=1))
    return p, plain


@pytest.mark.parametrize("step", [0.001, 0.0025])
def test_the_age_of_servo_forces_is_told_from_damping_that_one_joint_lacks(step):
    p, plain = _servos(step, np.array([0.0, 0.0, 0.05, 0.0]))
    # a simulated servo computes once a timestep and holds that
    assert staleness(p, [0, 1, 2, 3]) == pytest.approx(step / 2, abs=1e-4 + 0.1 * step)
    assert staleness(p, [0, 1]) == 0.0
    nominal = ActuatorSide(p.ctx).between_rows(plain)
    late = aged(with_drives(p, plain, *nominal), [0], 0.002).train[0]
    np.testing.assert_array_equal(late.integral[:, 1:], p.train[0].integral[:, 1:])
    t, smooth = late.recording.time, late.smooth[:, 0]
    # 8 ms into the row before, where the force bends away from a straight line
    before = np.interp(t - 0.002, t, smooth) - np.append(0.0, 0.5 * 0.008 * 0.002 * late.bend[:, 0])
    held = late.command[:-1, 0] - smooth[:-1]
    mean = held + 0.5 * (before[:-1] + before[1:]) - 0.01**2 / 12 * late.bend[:, 0]
    np.testing.assert_allclose(np.diff(late.integral[:, 0]), 0.01 * mean, atol=1e-12)


def _damped(p: Prepared, more: np.ndarray) -> Fitted:
    terms = [Term("viscous_damping", Place("joint", f"j{k}", k)) for k in range(4)]
    h = Hypothesis.of(*terms)
    theta = h.gather(p.ctx, {t: np.array([x]) for t, x in zip(terms, more, strict=True)})
    return Fitted(h, theta, theta)


def test_what_is_missing_at_the_joints_hides_the_age_until_it_is_known():
    more = np.array([0.3, 0.1, 0.6, 0.2])
    p, _ = _servos(0.0025, more)
    servos = [0, 1, 2, 3]
    assert staleness(p, servos) == 0.0 and other_age(p, servos, NOTHING) is None
    age = other_age(p, servos, _damped(p, more))
    assert age == pytest.approx(0.00125, rel=0.2)
    assert other_age(aged(p, servos, age), servos, _damped(p, more)) is None
    left = SimpleNamespace(fit=_damped(p, more), left=object())
    measurement = MeasurementModel.without_physics(p, {}, servos)
    again = measurement.with_moved_ages(left)
    assert age_of(again.read(), servos) == age and describe_age(age) in p.warnings
    assert again.with_moved_ages(left) is None
    assert measurement.with_moved_ages(SimpleNamespace(fit=left.fit, left=None)) is None


def test_what_an_encoder_reads_too_much_is_no_bias_of_its_servo():
    """The servo of the second joint is told 0.2 rad less than it reads, as its own encoder knows: force 6 (u - q)."""
    p, plain = _servos(0.001, np.zeros(4))
    offset = np.array([0.0, 0.2, 0.0, 0.0])
    off = with_zeros(p, {s.recording.log: -offset for s in p.sources})
    drives = diagnose_actuators(off, plain, ["actuator_bias"])
    assert [(e["id"], e["at"]) for e in drives.effects] == [("actuator_bias", "s1")]
    assert drives.effects[0]["parameters"]["bias"]["value"] == pytest.approx(6 * 0.2, rel=0.02)
    term = Term("encoder_offset", Place("joint", "j1", 1))
    found = Fitted(Hypothesis.of(term), np.array([0.2]), np.array([0.2]))
    assert as_encoders_read(off, plain, drives, found).effects == []
    assert as_encoders_read(off, plain, drives, NOTHING) is drives


def test_less_damping_than_modelled_at_one_joint_is_no_age():
    p, _ = _servos(0.0005, np.array([-0.018, 0.0, 0.0, 0.0]))
    assert staleness(p, [0, 1, 2, 3]) == 0.0


def _biased(r: Recording) -> Recording:
    assert r.force is not None
    return dataclasses.replace(r, force=r.force + 0.7)


def _saturated(r: Recording) -> Recording:
    assert r.force is not None
    return dataclasses.replace(r, force=np.clip(r.force, -1.0, 1.0))


@pytest.mark.parametrize("change", ["actuator_gain", "actuator_bias", "torque_saturation"])
def test_a_servo_that_was_found_to_differ_jumps_as_it_does(change):
    runs = _driven(0.0, gain=0.5 if change == "actuator_gain" else 1.0)
    if change != "actuator_gain":
        runs = [{"actuator_bias": _biased, "torque_saturation": _saturated}[change](r) for r in runs]
    p, _ = _search(runs)
    plain = compile_variable(p.spec)
    found = diagnose_actuators(p, plain, [i for i in REGISTRY if i.partition(":")[0] == change])
    assert found is not None and [e["id"] for e in found.effects] == [change]
    again = with_drives(p, plain, *found.between_rows(plain)).train[0]
    r = again.recording
    nominal = servo_jumps(r, again.states, plain)
    if change == "actuator_gain":
        jumps = 0.5 * nominal
    elif change == "actuator_bias":
        jumps = nominal
    else:
        ctrl, before = r.ctrl, np.concatenate([r.ctrl[:1], r.ctrl[:-1]])
        q, v = again.states.qpos, again.states.qvel
        now, then = (np.clip(plain_force(plain, 0, u, q, v), -1.0, 1.0) for u in (ctrl, before))
        jumps = (now - then)[:, None]
        assert np.abs(jumps - nominal).max() > 0.1
    mean = 0.5 * (again.command[:-1] + again.command[1:] - jumps[1:])
    np.testing.assert_allclose(np.diff(again.integral, axis=0), 0.01 * mean, atol=2e-4)


@pytest.mark.parametrize("unsure", [0.0, 0.3])
def test_a_gain_that_changes_no_more_than_the_motion_leaves_open_is_none(unsure):
    """A tenth more of forces of about 1 N m."""
    model = mujoco.MjModel.from_xml_string(MOTOR)
    rng, u, rows = np.random.default_rng(0), np.sin(0.2 * np.arange(400)), np.arange(400)
    still, noise = np.zeros(400), 0.002 * rng.standard_normal(400)
    log = Log("r", 0.01 * rows, u[None], rows, 1.1 * u + noise, still, still, rows // 25)
    data = Data([log], [log], 0.002, 0.01, unsure)
    ctx = dataclasses.replace(nominal_context(model), drive=np.array([1.0]))
    found = search_law(model, ctx, Place("actuator", "motor", 0), data, ["actuator_gain"])
    assert [t.id for t in found.hypothesis.terms] == ([] if unsure else ["actuator_gain"])


def test_a_late_servos_force_jumps_elsewhere():
    p, _ = _search(_driven(0.0, count=2))
    plain = compile_variable(p.spec)
    term = Term("actuator_delay", Place("actuator", "servo", 0))
    late = ActuatorSide(p.ctx, fits=[Fitted(Hypothesis.of(term), np.array([0.004]), np.zeros(1))])
    source = p.train[0]
    assert np.abs(ActuatorSide(p.ctx).between_rows(plain)[1](source).jumps).max() > 0.1
    assert not late.between_rows(plain)[1](source).jumps.any()


def test_a_search_simulates_what_a_fit_would_leave_once(monkeypatch):
    p, s = _search(_driven(0.2, count=2))
    made, own = [], setup.floor
    monkeypatch.setattr(setup, "floor", lambda *args: made.append(args) or own(*args))
    s.floor = setup.build_search(p, s.say, s.length).floor
    begun = p.sim.work
    first = s.floor(NOTHING)
    cost = p.sim.work - begun
    assert s.floor(NOTHING) is first and len(made) == 1
    # as much work as if it were simulated again
    assert p.sim.work - begun == pytest.approx(2.0 * cost) and cost > 0.0
    assert what_is_left(p, NOTHING, s)[0] is first


@pytest.mark.parametrize(("rate", "noise"), [(100, 0.2), (500, 0.4)])
def test_noise_in_measured_forces_is_in_the_floor(rate, noise):
    p, s = _search(_driven(noise, rate))
    assert force_noise(p)[0] == pytest.approx(noise, rel=0.3)
    nominal = NOTHING
    left = leaves(s, nominal).left
    losses = left.losses[left.typical]
    assert losses.mean() > 2.0
    assert Floor().exceeded(losses)
    found = floor(p, nominal, p.config.decide_s)
    assert not found.exceeded(losses)
    assert 0.4 < found.loss / losses.mean() < 2.0
    # and so it is in what the report calls noise alone, far above that of the positions
    told = fit_report(p, nominal, "test")
    quiet = noise_floor(p.sim, nominal, told.windows, p.noise, np.zeros(1))
    assert 0.5 < told.after.rms / told.floor < 1.6 and told.floor > 3.0 * np.sqrt(quiet.window.mean())


@pytest.mark.parametrize("unknown", [False, True])
def test_a_drive_that_no_law_explains_is_unexplained(unknown):
    """Known: half the nominal force. Unknown: a ripple of a fifth of it that only time sets, beside that."""
    recordings = []
    for r in _driven(0.01, gain=0.5):
        ripple = np.sin(31.0 * r.time + np.cumsum(np.sin(7.0 * r.time)))[:, None]
        recordings.append(
            dataclasses.replace(r, force=r.force + unknown * 0.2 * np.abs(r.force).max() * ripple)
        )
    spec = mujoco.MjSpec.from_string(SERVO)
    plain = compile_variable(spec)
    p = prepare(spec, [validate(r, plain, names_of(plain)) for r in recordings], Config(jobs=1))
    found = diagnose_actuators(p, plain, ["actuator_gain", "actuator_gain:limited", "actuator_lag"])
    assert [t.name for f in found.fits for t in f.hypothesis.terms] == ["actuator_gain"]
    assert [u["at"] for u in found.left] == ([["servo"]] if unknown else [])
    for u in found.left:
        assert 0.0 < u["share"] < 1.0 and u["intervals"]


@pytest.mark.parametrize(
    ("terms", "forces"),
    [
        ({"actuator_gain": [1.6]}, [-0.8, 0.32, 0.8]),
        ({"actuator_gain": [-1.0]}, [0.5, -0.2, -0.5]),
        ({"actuator_gain:limited": [1.6]}, [-0.5, 0.32, 0.5]),
        ({"actuator_bias": [0.2]}, [-0.3, 0.4, 0.7]),
        ({"actuator_bias:limited": [0.2]}, [-0.5, 0.4, 0.5]),
        ({"actuator_deadzone": [0.1]}, [-0.4, 0.1, 0.4]),
        ({"actuator_deadzone:limited": [0.1]}, [-0.5, 0.1, 0.5]),
        ({"actuator_gain": [0.5], "torque_saturation": [0.2]}, [-0.2, 0.1, 0.2]),
        ({"torque_saturation": [0.9]}, [-0.5, 0.2, 0.5]),
        ({"actuator_gain": [1.6], "actuator_deadzone": [0.1]}, [-0.7, 0.22, 0.7]),
        ({"actuator_bias": [0.2], "actuator_deadzone": [0.1]}, [-0.2, 0.3, 0.6]),
        ({"actuator_bias": [0.6], "actuator_deadzone": [0.2]}, [0.0, 0.6, 0.9]),
        ({"actuator_bias": [0.7], "torque_saturation": [0.1]}, [0.1, 0.1, 0.1]),
    ],
)
def test_effects_of_actuators_act_on_forces_within_their_limits(terms, forces):
    """A motor of at most 0.5 N m that is told -1, 0.2 and 1; its joint bears more."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="hinge" actuatorfrcrange="-2 2"/><geom size=".1"/></body></worldbody>
        <actuator><motor name="motor" joint="hinge" forcerange="-0.5 0.5"/></actuator></mujoco>"""
    )
    ctx, place = nominal_context(model), Place("actuator", "motor", 0)
    parts = {Term(i, place): np.array(x) for i, x in terms.items()}
    assert all(place in REGISTRY[t.id].places(ctx) for t in parts)
    h = Hypothesis.of(*parts)
    rest = np.zeros(3)
    log = Log("r", 0.01 * np.arange(3), np.array([[-1.0, 0.2, 1.0]]), np.arange(3), rest, rest, rest, rest)
    f = Fitted(h, h.gather(ctx, parts), np.zeros(0))
    np.testing.assert_allclose(predict(model, ctx, f, 0, log, 0.01), forces, atol=1e-12)


def test_what_came_before_a_log_is_nothing_unexplained():
    """Twenty logs of a second, of a motor with a lag of 50 ms, that begin in the midst of motion."""
    model = mujoco.MjModel.from_xml_string(MOTOR)
    ctx, term = nominal_context(model), Term("actuator_lag", Place("actuator", "motor", 0))
    rng, lag, dt, logs = np.random.default_rng(0), 0.05, 0.01, []
    for k in range(20):
        t = dt * np.arange(200)
        u = np.sin(np.outer(t, rng.uniform(3, 25, 6)) + rng.uniform(0, 6, 6)).sum(1)
        late = np.zeros(200)
        for i in range(199):
            late[i + 1] = u[i] + (late[i] - u[i]) * np.exp(-dt / lag)
        force, rows = late[100:] + 1e-3 * rng.standard_normal(100), np.arange(100)
        rest = np.zeros(100)
        logs.append(Log(f"run_{k}", t[:100], u[None, 100:], rows, force, rest, rest, 4 * k + rows // 25))
    ctx = dataclasses.replace(ctx, drive=np.array([3.0]))
    f = Fitted(Hypothesis.of(term), np.array([lag]), np.zeros(0))
    assert unexplained_drive(model, ctx, f, 0, Data(logs, logs, 1e-3, dt)) is None
    wrong = dataclasses.replace(f, theta=np.array([4 * lag]))
    left = unexplained_drive(model, ctx, wrong, 0, Data(logs, logs, 1e-3, dt))
    assert left is not None and len(left["intervals"]) == 8


@pytest.mark.parametrize("rows_late", [1, 8])
def test_a_delay_is_not_called_a_lag_beside_it(rows_late):
    """However far it is from where the search begins. Between two rows every delay makes the same forces."""
    model = mujoco.MjModel.from_xml_string(MOTOR)
    rng, logs = np.random.default_rng(0), []
    for k in range(6):
        t = 0.01 * np.arange(400)
        u = np.sin(np.outer(t, rng.uniform(3, 25, 6) / rows_late) + rng.uniform(0, 6, 6)).sum(1)
        grid = np.repeat(u, 2)
        force = np.concatenate([np.full(rows_late + 1, u[0]), u[: -rows_late - 1]])
        force += 1e-2 * rng.standard_normal(400)
        rest, rows = np.zeros(400), np.arange(400)
        logs.append(Log(f"run_{k}", t, grid[None], 2 * rows, force, rest, rest, 16 * k + rows // 25))
    data = Data(logs[:4], logs[4:], 1e-2, 0.005)
    ctx = dataclasses.replace(nominal_context(model), drive=np.array([3.0]), period=0.01)
    found = search_law(model, ctx, Place("actuator", "motor", 0), data, ["actuator_lag", "actuator_delay"])
    assert [t.id for t in found.hypothesis.terms] == ["actuator_delay"]
    # a force that is seen at the rows alone tells the delay to a row, in the middle of those that are as likely
    least, most = 0.01 * rows_late, 0.01 * (rows_late + 1)
    assert least < found.theta[0] <= most
    deviation = float(np.sqrt(found.cov[0, 0]))
    assert 0.0005 < deviation < 0.005


@pytest.mark.parametrize(
    ("rate", "bias", "late", "seen"),
    [
        (0.6, 0.1, 0.0, True),
        (25.0, 0.1, 0.0, True),
        (0.0, 0.1, 0.0, True),
        (0.0, 0.01, 0.0, False),
        (25.0, 0.0, 0.002, False),
        (25.0, 0.0, -0.004, False),
    ],
)
def test_a_small_bias_is_no_matter_of_timing_and_the_moment_of_a_force_is(rate, bias, late, seen):
    """0.1 N m are 1.25 % of the largest force; at 25 rad/s the command changes by more within two timesteps of 2 ms,
    but not always the same way. Forces that are measured a timestep or two later or earlier lack nothing. Where
    commands are held, less than 0.5 % are a matter of the sensor."""
    model = mujoco.MjModel.from_xml_string(MOTOR)
    rng, logs = np.random.default_rng(0), []
    for k in range(6):
        t = 0.01 * np.arange(400)
        u = 8.0 * (np.sin(rate * t + k) if rate else (-1.0) ** (np.arange(400) // 50 + k))
        felt = 8.0 * np.sin(rate * (t - late) + k) if late else u
        rest, rows = np.zeros(400), np.arange(400)
        force = felt + bias + 1e-3 * rng.standard_normal(400)
        logs.append(Log(f"run_{k}", t, u[None], rows, force, rest, rest, 16 * k + rows // 25))
    data = Data(logs[:4], logs[4:], 1e-3, 0.01)
    ctx = dataclasses.replace(nominal_context(model), drive=np.array([8.0]), period=0.01)
    ids = ["actuator_gain", "actuator_bias", "actuator_deadzone"]
    found = search_law(model, ctx, Place("actuator", "motor", 0), data, ids)
    assert [t.id for t in found.hypothesis.terms] == ["actuator_bias"] * int(seen)
    assert not seen or found.theta[0] == pytest.approx(bias, abs=1e-3)


@pytest.mark.parametrize("limit", [2.0, np.inf])
def test_a_limit_that_is_reached_in_three_stretches_of_forty_is_seen(limit):
    """One burst of commands each in the training and the held-out logs; a quarter of the stretches are noisier."""
    model = mujoco.MjModel.from_xml_string(MOTOR)
    rng, logs = np.random.default_rng(0), []
    for k in range(8):
        t = 0.01 * np.arange(400)
        u = np.sin(np.outer(t, rng.uniform(3, 25, 6)) + rng.uniform(0, 6, 6)).sum(1) / 4
        u[100:170] *= 4 if k in (0, 6) else 1
        rest, rows = np.zeros(400), np.arange(400)
        noise = np.where(rows // 25 % 4, 1e-2, 5e-2) * rng.standard_normal(400)
        force = np.clip(u, -limit, limit) + noise
        logs.append(Log(f"run_{k}", t, u[None], rows, force, rest, rest, 16 * k + rows // 25))
    data = Data(logs[:5], logs[5:], 2e-2, 0.01)
    ctx = dataclasses.replace(nominal_context(model), drive=np.array([2.0]), period=0.01)
    place = Place("actuator", "motor", 0)
    found = search_law(model, ctx, place, data, ["torque_saturation", "actuator_gain", "actuator_deadzone"])
    assert [t.id for t in found.hypothesis.terms] == ["torque_saturation"] * int(np.isfinite(limit))
    assert not found.theta.size or found.theta[0] == pytest.approx(limit, rel=0.02)
