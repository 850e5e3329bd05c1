"""Encoders whose zeros differ from recording to recording."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import Config, Recording, diagnose
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.measurement.encoder_zeros import (
    _at_stops,
    describe_zeros,
    other_zeros,
    with_zeros,
)
from tests.diagnosis.machines import ARM, BOX, really_sticks, record
from tests.diagnosis.searches import prepared_of

SIZE = [1.5, 0.6]


def shifted(recordings: list[Recording], zeros: dict[int, list[float]]) -> list[Recording]:
    return [replace(r, qpos=r.qpos + zeros.get(k, 0.0)) for k, r in enumerate(recordings)]


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    return record(ARM, SIZE, count=5, seconds=5.0)


def test_zeros_of_single_recordings_are_found(runs):
    zeros = {1: [0.0, 0.04], 3: [-0.05, 0.02]}
    p = prepared_of(ARM, shifted(runs, zeros))
    found = other_zeros(p, NOTHING)
    assert set(found) == {r.name for r in runs}
    for k, r in enumerate(runs):
        assert found[r.name] == pytest.approx(zeros.get(k, [0.0, 0.0]), abs=2e-3)
    less = with_zeros(p, found)
    true = {r.name: (r.time, r.qpos) for r in runs}
    for s in less.sources:
        time, qpos = true[s.recording.log]
        rows = np.searchsorted(time, s.recording.time - 1e-9)
        np.testing.assert_allclose(s.recording.qpos, qpos[rows], atol=2e-3)
        np.testing.assert_allclose(s.states.qpos, qpos[rows], atol=3e-3)
    # a test recording told its own by its beginning, which it is then not judged by
    assert all(s.spent >= 5.0 / 3.0 - 0.02 for s in less.test)
    assert [s.spent for s in less.looked_at] == [s.spent for s in p.looked_at]
    said = describe_zeros(p, found)
    assert "run_1 reads 0.04 rad more at the elbow" in said and "less at the shoulder" in said


def test_equal_zeros_and_other_physics_are_no_differences_of_zeros(runs):
    assert not other_zeros(prepared_of(ARM, runs), NOTHING)
    # the same zeros everywhere are an effect, `encoder_offset`
    assert not other_zeros(prepared_of(ARM, shifted(runs, {k: [0.05, 0.0] for k in range(5)})), NOTHING)

    def bumpy(model, data):
        data.qfrc_applied[1] = -0.15 * np.sign(data.qvel[1]) * (abs(data.qpos[1]) < 0.2)

    assert not other_zeros(prepared_of(ARM, record(ARM, SIZE, force=bumpy, count=5)), NOTHING)


def test_a_recording_far_off_is_found_too(runs):
    found = other_zeros(prepared_of(ARM, shifted(runs, {1: [0.6, -0.6]})), NOTHING)
    assert found["run_1"] == pytest.approx([0.6, -0.6], abs=0.02)
    assert all(np.abs(zero).max() < 0.02 for name, zero in found.items() if name != "run_1")


def test_windows_in_which_a_joint_comes_to_its_stop_do_not_count(runs):
    p = prepared_of(ARM.replace('name="elbow"', 'name="elbow" limited="true" range="-50 50"'), runs)
    w = p.windows("train", p.config.decide_s, 100)
    ends = (np.abs(w.qpos[..., 1]) > 0.98 * np.deg2rad(50)).any(1)
    assert 0 < ends.sum() < w.count
    np.testing.assert_array_equal(_at_stops(p, w), ends)


def test_nothing_is_said_of_machines_that_strike_things():
    runs = record(BOX, 6.0, count=4)
    assert not other_zeros(prepared_of(BOX, shifted(runs, {1: [0.0, 0.02]})), NOTHING)


@pytest.mark.slow
def test_a_held_out_session_with_other_zeros_does_not_hide_what_is_missing():
    def rub(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[0] = 0.3
        really_sticks(model, 0)

    runs = shifted(record(ARM, SIZE, rub, count=5, seconds=4.0), {1: [0.03, 0.05], 4: [0.06, -0.05]})
    tried = (
        "coulomb_friction",
        "encoder_offset",
        "com_offset",
        "actuator_bias",
    )
    config = Config(jobs=1, quiet=True, held_out=("run_4",), effects=tried)
    d = diagnose(mujoco.MjSpec.from_string(ARM), runs, config)
    assert d.verdict == "effects" and [str(t) for t in d.terms] == ["coulomb_friction@shoulder"]
    assert d.fit.theta == pytest.approx([0.3], rel=0.03)
    assert any("zeros differ between recordings" in w and "run_4" in w for w in d.warnings)
    # the error of its own zero is no part of the floor
    assert d.held.after.rms < 2.5 * d.held.floor
