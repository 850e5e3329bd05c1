"""Windows: what actuators' filters hold where one starts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording, diagnose
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.evidence.null_distribution import floor
from mpge_jax.diagnosis.recordings.recording import rows_of
from mpge_jax.diagnosis.recordings.states import States
from mpge_jax.diagnosis.recordings.three_parts import PARTS
from mpge_jax.diagnosis.simulation.driving.actuator_state import activations
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from tests.diagnosis.machines import FINE_PENDULUM
from tests.diagnosis.searches import prepared_of

FILTER = FINE_PENDULUM.replace("<motor", '<general dyntype="filterexact" dynprm=".03"')
MUSCLE = FINE_PENDULUM.replace("<motor", '<muscle lengthrange="-2 2" timeconst=".02 .05" force="3"')
CLIPPED = FILTER.replace('ctrlrange="-2 2"', 'ctrlrange="0 .6"')
LATE = FILTER.replace("<general", '<general delay=".03" nsample="20"')
MUSCLE = MUSCLE.replace('ctrlrange="-2 2"', 'ctrlrange="0 1"')
RATE = 100


def _record(xml: str, runs: int = 3) -> tuple[list[Recording], list[np.ndarray]]:
    """Recordings that begin with empty filters, and the activations along them."""
    out, activations = [], []
    rng = np.random.default_rng(0)
    for k in range(runs):
        model = mujoco.MjModel.from_xml_string(xml)
        data, rows, act = mujoco.MjData(model), [], []
        for i in range(4 * RATE):
            u = 0.5 + 0.4 * np.sign(np.sin(0.13 * i + k))
            rows.append((i / RATE, data.qpos[0], u))
            act.append(data.act[0])
            data.ctrl[0] = u
            mujoco.mj_step(model, data, round(1 / RATE / model.opt.timestep))
        t, q, u = np.array(rows).T
        q = q + 1e-5 * rng.standard_normal(q.size)
        out.append(Recording(f"run_{k}", t, q[:, None], None, u[:, None]))
        activations.append(np.array(act))
    return out, activations


@pytest.mark.parametrize(("xml", "settling"), [(FILTER, 0.15), (CLIPPED, 0.15), (LATE, 0.18), (MUSCLE, 0.4)])
def test_windows_start_with_the_activation_that_the_commands_left(xml, settling):
    recordings, activations = _record(xml)
    p = prepared_of(xml, recordings)
    w = p.windows("train", 0.25, 40)
    assert w.start.min() >= settling
    names = {r.name: a for r, a in zip(recordings, activations, strict=True)}
    for source, start, act in zip(w.source, w.start, w.act0[:, 0], strict=True):
        true = names[w.sources[source].recording.name][round(start * RATE)]
        # at the start the filter was taken for settled: e^-5 of the command
        assert act == pytest.approx(true, abs=0.01)


def test_what_a_filter_held_before_the_recording_is_no_physics():
    d = diagnose(mujoco.MjSpec.from_string(FILTER), _record(FILTER)[0], Config(jobs=1))
    assert d.verdict == "none"


def test_short_recordings_of_slow_filters_still_hold_windows():
    xml = FILTER.replace('".03"', '".1"')
    recordings = [
        Recording(r.name, r.time[:50], r.qpos[:50], None, r.ctrl[:50]) for r in _record(xml, runs=6)[0]
    ]
    p = prepared_of(xml, recordings)
    for part in PARTS:
        assert p.windows(part, p.config.decide_s, 40).count and p.windows(part, p.config.report_s, 40).count


def test_the_floor_of_slow_filters_is_the_noise():
    xml = FILTER.replace('".03"', '".1"')
    p = prepared_of(xml, _record(xml)[0])
    noise = floor(p, NOTHING, p.config.decide_s)
    # below one: a share of what the timestep changes counts as noise, and the simulated recordings have none of that
    assert 0.2 < noise.loss < 1.2 and noise.losses.max() < 3.0


def test_commands_act_later_and_in_finer_steps():
    """Commands change by 1 each hundredth of a second; a window's steps are 2 ms."""
    rows = 200
    ctrl = np.arange(rows, dtype=float)[:, None] / 100
    recordings = [
        Recording(f"run_{k}", np.arange(rows) / RATE, 1e-3 * np.sin(np.arange(rows) + k)[:, None], None, ctrl)
        for k in range(3)
    ]
    w = prepared_of(FINE_PENDULUM, recordings).windows("train", 0.25, 40)
    for k in range(w.count):
        at = w.start[k] + w.dt * np.arange(-w.history, w.steps)
        held = np.clip(np.floor(at * RATE + 1e-6) / 100, 0.0, None)
        np.testing.assert_allclose(w.command[k, :, 0], held, atol=1e-9)
        # an eighth of the step that follows a row is still the row before
        first = (np.abs(at * RATE - np.round(at * RATE)) < 1e-6) & (at > 1e-6)
        np.testing.assert_allclose(w.later(w.dt / 8).command[k, :, 0], held - first / 800, atol=1e-9)
        fine = w.refined(2).command[k, -2 * w.steps :, 0]
        np.testing.assert_allclose(fine, np.repeat(held[w.history :], 2), atol=1e-9)


def test_an_integrator_goes_on_where_the_log_was_cut():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body><joint name="j" axis="0 1 0"/><geom size=".1"/></body></worldbody><actuator>
        <intvelocity joint="j" kp="10" actrange="-.5 .5"/></actuator></mujoco>"""
    )
    time = 0.01 * np.arange(201)
    ctrl = np.where(time < 1.2, 1.0, -1.0)[:, None]
    whole = Recording("run", time, np.zeros((201, 1)), None, ctrl)
    middle = rows_of(whole, slice(60, 160), "middle")
    last = rows_of(middle, slice(40, None), "last")
    states = States(*(np.zeros((201, 1)) for _ in range(3)), np.zeros((201, 1, 2, 2)))
    along = activations(model, Source.build(whole, states, ctrl))[:, 0]
    assert along.max() == 0.5 and along[-1] == pytest.approx(-0.3)
    for r, rows in ((middle, slice(60, 160)), (last, slice(100, 160))):
        np.testing.assert_allclose(activations(model, Source.build(r, states, r.ctrl))[:, 0], along[rows])
