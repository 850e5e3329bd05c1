"""Commands on a clock of their own: what all actuators have in common is clock or delay, and taken off."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, diagnose
from mpge_jax.diagnosis.machine.model import names_of
from mpge_jax.diagnosis.recordings.command_lag import LONGEST, Lag, common_lag, what_drives
from mpge_jax.diagnosis.recordings.formats.tables import Column, Log, Table
from mpge_jax.diagnosis.recordings.reader import read_log
from tests.diagnosis.machines import ARM, excitation, record

RATE, SECONDS = 100, 4.0
SENT = np.arange(0, SECONDS, 0.01) + 0.0013
"""s at which commands are sent, between the rows of the states."""
ACTUATORS = ("shoulder_motor", "elbow_servo")


def lag_in(time, qpos, qvel, ctrl, model) -> Lag | None:
    return common_lag(what_drives(time, qpos, qvel, ctrl, model), ctrl)


def _arm():
    model = mujoco.MjModel.from_xml_string(ARM)
    return model, names_of(model)


def _recorded(delays: tuple[float, float], kind: int = 1):
    """Times, positions and velocities of an arm with friction whose actuators act late, and the commands sent."""
    model = mujoco.MjModel.from_xml_string(ARM)
    model.opt.timestep, model.dof_frictionloss[:] = 0.001, 0.1
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    phase = rng.uniform(0, 6, 2)
    commands = np.array([excitation(kind, t, phase, np.array([2.0, 0.8])) for t in SENT])
    rows = []
    for i in range(round(SECONDS / 0.001)):
        t = 1e-3 * i
        if i % 10 == 0:
            rows.append((t, data.qpos.copy(), data.qvel.copy()))
        for a, delay in enumerate(delays):
            data.ctrl[a] = commands[max(np.searchsorted(SENT, t - delay, side="right") - 1, 0), a]
        mujoco.mj_step(model, data)
    time, q, v = (np.array(x) for x in zip(*rows, strict=True))
    return time, q + 1e-4 * rng.standard_normal(q.shape), v + 1e-3 * rng.standard_normal(v.shape), commands


def _log(time, q, v, commands, clock=0.0):
    """As two topics give it; clock: s by which stamps of the commands are late."""
    parts = ("shoulder", "elbow")
    states = Table(
        "/s", (Column("/s/q", q, parts, "qpos"), Column("/s/v", v, parts, "qvel")), time, "header stamps"
    )
    return Log(
        "run", (states, Table("/c", (Column("/c", commands, None, "ctrl"),), SENT + clock, "header stamps"))
    )


@pytest.mark.parametrize(
    ("delays", "clock", "common"),
    [
        ((0.0, 0.0), 0.0, 0.0),
        ((0.03, 0.03), 0.0, 0.03),
        ((0.0, 0.0), 0.05, -0.05),
        ((0.06, 0.03), 0.0, 0.03),
        # the late one alone acts at its stamps: the other is ahead of them, which is the clock's
        ((0.03, 0.0), 0.03, -0.03),
    ],
)
@pytest.mark.parametrize("velocities", [True, False])
def test_what_all_actuators_have_in_common_is_found(delays, clock, common, velocities, tmp_path):
    time, q, v, commands = _recorded(delays)
    late = SENT + clock
    at = np.searchsorted(late, time + 0.005, side="right") - 1
    ctrl = commands[np.maximum(at, 0)]
    lag = lag_in(time, q, v if velocities else None, ctrl, _arm()[0])
    assert lag.common == pytest.approx(common, abs=0.004)
    assert list(lag.each) == [0, 1]
    for a, delay in enumerate(delays):
        assert lag.each[a] == pytest.approx(delay - clock, abs=0.004)
    assert lag.matters == (common != 0.0)


def test_it_is_taken_off_and_told():
    time, q, v, commands = _recorded((0.03, 0.03))
    told = read_log(_log(time, q, v, commands), "run", *_arm())
    prompt = _recorded((0.0, 0.0))
    true = read_log(_log(*prompt), "run", *_arm())
    # the command that acted from a row on stands in it: three rows later than it was sent
    rows = np.searchsorted(told.time, true.time[:-3] + 0.03 - 1e-9)
    np.testing.assert_array_equal(told.ctrl[rows], true.ctrl[:-3])
    text = " ".join(told.warnings)
    assert "/c comes apart from /s" in text
    assert "commands act 3" in text and "clock or delay" in text and "no actuator's effect" in text
    assert "at their stamps, to within half a row" in " ".join(true.warnings)
    assert told.clock_within == true.clock_within == pytest.approx(0.005)


def test_what_differs_is_left_to_the_actuators():
    own = Lag(0.03, {0: 0.03, 1: 0.06}, 0.01).told(ACTUATORS)
    assert (
        "and not alike (shoulder_motor 30 ms, elbow_servo 60 ms)" in own and "What all have in common" in own
    )
    assert "not alike" not in Lag(0.03, {0: 0.03, 1: 0.035}, 0.01).told(ACTUATORS)
    assert "before their stamps" in Lag(-0.03, {0: -0.03}, 0.01).told(ACTUATORS)


SERVOS = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
<joint name="shoulder" axis="0 1 0" damping=".05" armature=".006"/>
<geom type="capsule" fromto="0 0 0 .12 0 0" size=".015" mass=".2"/>
<body name="hand" pos=".12 0 0"><joint name="wrist" axis="0 1 0" damping=".03" armature=".004"/>
<geom type="capsule" fromto="0 0 0 .1 0 0" size=".015" mass=".11"/></body></body></worldbody>
<actuator><position joint="shoulder" kp="14" kv=".5"/><position joint="wrist" kp="6" kv=".2"/></actuator></mujoco>"""


def test_inertia_that_is_missing_is_no_lag():
    """Smooth commands and a hand that is three times as heavy as the model says."""

    def heavier(model):
        model.body_mass[2] += 0.3
        model.body_inertia[2] += [3e-5, 2.7e-3, 2.7e-3]

    for r in record(SERVOS, [0.9, 0.9], change=heavier, seconds=8.0, rate=60, count=10)[::3]:
        lag = lag_in(r.time, r.qpos, None, r.ctrl, mujoco.MjModel.from_xml_string(SERVOS))
        assert list(lag.each) == [0, 1]
        np.testing.assert_allclose(list(lag.each.values()), 0.0, atol=0.2 * lag.step)


def test_commands_that_explain_nothing_tell_nothing():
    time, q, v, _ = _recorded((0.0, 0.0))
    model = _arm()[0]
    noise = np.random.default_rng(1).standard_normal((time.size, 2))
    assert lag_in(time, q, v, noise, model) is None
    assert lag_in(time, q, v, np.ones((time.size, 2)), model) is None
    assert lag_in(time[:50], q[:50], v[:50], noise[:50], model) is None
    still = np.zeros_like(q)
    assert lag_in(time, still, still, noise, model) is None
    free = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    assert lag_in(time, np.zeros((time.size, 7)), None, np.zeros((time.size, 0)), free) is None
    # one tone may be late or of another phase: its lag cannot be told from damping and stiffness
    slow = read_log(_log(*_one_tone()), "run", *_arm())
    assert "cannot be told" in " ".join(slow.warnings)
    assert slow.clock_within == LONGEST


def _one_tone():
    time = np.arange(0, SECONDS, 0.01)
    q = 0.3 * np.stack([np.sin(3 * time), np.sin(3 * time)], 1)
    v = 0.9 * np.stack([np.cos(3 * time), np.cos(3 * time)], 1)
    return time, q, v, np.stack([np.sin(3 * SENT + 0.7), np.sin(3 * SENT - 0.4)], 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delays", "named"), [((0.03, 0.03), []), ((0.03, 0.06), ["elbow_servo"])], ids=["alike", "not alike"]
)
def test_a_diagnosis_names_no_delay_that_may_be_the_clocks(delays, named):
    recordings = [
        dataclasses.replace(read_log(_log(*_recorded(delays, kind)), "run", *_arm()), name=f"run_{kind}")
        for kind in range(3)
    ]
    effects = ("actuator_delay", "coulomb_friction", "viscous_damping")
    found = diagnose(mujoco.MjSpec.from_string(ARM), recordings, Config(jobs=1, quiet=True, effects=effects))
    assert [t.place.name for t in found.terms if t.name == "actuator_delay"] == named
    assert {t.place.name for t in found.terms if t.name == "coulomb_friction"} == {"shoulder", "elbow"}
    assert any("clock or delay" in w for w in found.warnings)
