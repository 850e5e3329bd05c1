"""Delays shorter than a row: forces measured at the rows do not tell them, the motion does."""

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording, diagnose
from mpge_jax.diagnosis.dataset.preparation import prepare
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.null_distribution import floor, force_noise
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.measurement.delay_within_a_row import (
    Arrival,
    arrivals,
    arriving,
    row_of,
    with_arrivals,
)
from mpge_jax.diagnosis.recordings.recording import rows_of
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.recordings.validation import validate
from mpge_jax.diagnosis.simulation.driving.actuator_state import settling
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from tests.diagnosis.machines import FINE_PENDULUM, excitation

PERIOD, STEP = 0.01, 0.0005
# in coarser steps a machine answers half a step earlier
FINE = FINE_PENDULUM.replace('timestep="0.002"', f'timestep="{STEP}"')


def _recordings(delay: float, friction: float = 0.0, rows_each: int = 300) -> list[Recording]:
    """A motor that obeys late, with its force at every row."""
    rng, out, late = np.random.default_rng(0), [], round(delay / STEP)
    model = mujoco.MjModel.from_xml_string(FINE)
    model.dof_frictionloss[:] = friction
    per = round(PERIOD / STEP)
    for k in range(4):
        data, rows, sent = mujoco.MjData(model), [], []
        for i in range(rows_each):
            u = excitation(k % 2 * 2, i * PERIOD, np.array([k]), np.array([0.8]))
            sent += [u] * per
            for j in range(per):
                data.ctrl[:] = sent[max(i * per + j - late, 0)]
                if j == 0:
                    mujoco.mj_forward(model, data)
                    rows.append((i * PERIOD, data.qpos.copy(), u, data.actuator_force.copy()))
                mujoco.mj_step(model, data)
        time, q, u, force = (np.array(x) for x in zip(*rows, strict=True))
        out.append(Recording(f"run_{k}", time, q + 1e-4 * rng.standard_normal(q.shape), None, u, force))
    return out


@pytest.mark.parametrize("delay", [0.0035, 0.017])
def test_the_motion_tells_where_between_rows_a_delay_lies(delay):
    found = diagnose(mujoco.MjSpec.from_string(FINE), _recordings(delay), Config(jobs=1))
    assert found.verdict == "effects" and not found.terms
    (entry,) = found.to_json()["effects"]
    assert (entry["id"], entry["at"]) == ("actuator_delay", "motor")
    value = entry["parameters"]["delay"]
    assert value["value"] == pytest.approx(delay, abs=0.0005)
    assert value["low"] <= delay <= value["high"]
    # less than the row that the forces leave open
    assert value["high"] - value["low"] < 0.6 * PERIOD


@pytest.mark.slow
def test_friction_that_the_model_lacks_too_does_not_shift_the_delay(plain_functions):
    # few candidates and rows: steps as fine as these take long
    effects = ("coulomb_friction", "viscous_damping", "actuator_delay", "actuator_lag")
    config = Config(jobs=1, effects=effects)
    found = diagnose(mujoco.MjSpec.from_string(FINE), _recordings(0.0125, 0.1, rows_each=120), config)
    entries = {e["id"]: e["parameters"] for e in found.to_json()["effects"]}
    assert set(entries) == {"coulomb_friction", "actuator_delay"}
    assert entries["actuator_delay"]["delay"]["value"] == pytest.approx(0.0125, abs=0.0005)
    assert entries["coulomb_friction"]["torque"]["value"] == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize(
    ("fitted", "rows"), [(0.005, 0), (0.01, 0), (0.0, 0), (0.0151, 1), (0.02, 1), (0.0251, 2)]
)
def test_rows_that_surely_pass(fitted, rows):
    # fits of forces at rows lie between the half-way point and the end of the row, or at its end exactly
    assert row_of(fitted, PERIOD) == pytest.approx((rows * PERIOD, (rows + 1) * PERIOD))


def _source(time: np.ndarray, force: np.ndarray) -> Source:
    n = time.size
    states = States(np.zeros((n, 1)), np.zeros((n, 1)), np.zeros((n, 1)), np.zeros((n, 1, 2, 2)))
    column = force[:, None]
    return Source.build(Recording("r", time, np.zeros((n, 1)), None, column, column), states, column)


def test_a_force_begins_when_its_command_arrives():
    time = 0.1 * np.arange(5)
    source = _source(time, np.array([1.0, 1.0, 3.0, 2.0, 2.0]))
    # the command of 0 makes the force of 0.2: it begins at 0.13, the next one at 0.23
    late = arriving(source, {0: 0.13})
    np.testing.assert_allclose(late.mean_command(time)[2:, 0], [0.3 * 3 + 0.7 * 2, 2.0], atol=1e-12)
    assert settling(late, mujoco.MjModel.from_xml_string(FINE_PENDULUM)) == pytest.approx(
        0.08
    )  # a fifth of the log
    # one of whole rows is in the forces as it is
    np.testing.assert_allclose(arriving(source, {0: 0.2}).mean_command(time)[2:, 0], [3.0, 2.0])


def test_a_force_begins_when_its_command_arrives_by_a_jittered_clock_too():
    time = np.array([0.0, 0.12, 0.19, 0.31, 0.4])
    # sent at 0, 0.12, 0.19: they arrive at 0.1, 0.22, 0.29
    source = _source(time, np.array([0.0, 1.0, 1.0, 3.0, 4.0]))
    edges = np.array([0.1, 0.22, 0.29, 0.35])
    np.testing.assert_allclose(
        arriving(source, {0: 0.1}).mean_command(edges)[:, 0], [1.0, 3.0, 3.0], atol=1e-12
    )


def test_the_floor_knows_that_a_late_force_changes_between_rows():
    spec = mujoco.MjSpec.from_string(FINE)
    plain = compile_variable(spec)
    recordings = [validate(r, plain, names_of(plain)) for r in _recordings(0.0055)]
    at_rows = prepare(spec, recordings, Config(jobs=1))
    p = with_arrivals(at_rows, {0: Arrival(0.0055, 1e-4)})
    assert force_noise(p)[0] < 1e-3
    # what is simulated with that delay and read without it leaves several times the noise
    assert floor(p, NOTHING, p.config.decide_s).loss < 1.3


def test_motors_that_the_motion_cannot_tell_apart_share_their_delay():
    """Two motors on one joint with equal forces: the sum of their delays is known, their difference is not."""
    twins = FINE.replace("</actuator>", '<motor name="second" joint="hinge" ctrlrange="-2 2"/></actuator>')
    recordings = []
    for r in _recordings(0.0125):
        both = (np.repeat(0.5 * x, 2, 1) for x in (r.ctrl, r.force))
        recordings.append(Recording(r.name, r.time, r.qpos, None, *both))
    spec = mujoco.MjSpec.from_string(twins)
    plain = compile_variable(spec)
    p = prepare(spec, [validate(r, plain, names_of(plain)) for r in recordings], Config(jobs=1))
    row = (0.01, 0.02)
    found = arrivals(p, NOTHING, {0: row, 1: row})
    assert [x.delay for x in found.values()] == pytest.approx([0.0125, 0.0125], abs=0.0005)
    assert all(0.0015 < x.deviation < 0.003 for x in found.values())
    # too few windows to tell
    short = [rows_of(r, slice(0, 60), r.name) for r in recordings[:2]]
    p = prepare(spec, [validate(r, plain, names_of(plain)) for r in short], Config(jobs=1, decide_s=0.5))
    (told,) = arrivals(p, NOTHING, {0: row}).values()
    assert (told.delay, told.deviation) == pytest.approx((0.015, 0.01 / np.sqrt(12)))
