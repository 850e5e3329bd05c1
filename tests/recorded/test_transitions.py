"""Logs as transitions of a task: at its control step, in its columns, and one sentence for what does not fit."""

import re

import mujoco
import numpy as np
import pytest

import envs
from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.corrected.tasks import nominal_spec
from mpge_jax.recorded import transitions
from tests import small
from tests.recorded.logs import moved, of_target_log, swing

TASK = "InvertedPendulum"


def read(folder, log: dict[str, np.ndarray] | None = None, **options) -> transitions.Recorded:
    if log is not None:
        np.savez(folder / "run.npz", **log)
    return transitions.read([folder], TASK, **options)


def both(found: transitions.Recorded, name: str) -> np.ndarray:
    return np.concatenate([getattr(part, name) for part in (found.train, found.held)])


def test_a_log_at_the_tasks_rate_gives_the_transitions_that_were_recorded(tmp_path):
    found = read(of_target_log(tmp_path))
    recorded = small.log(size=2, steps=80).rows()
    asked = np.concatenate([recorded["observation"], recorded["action"]], axis=1)
    for part in (found.train, found.held):
        assert part.size > 5
        found_at = np.concatenate([part.observation, part.action], axis=1)
        distance = np.abs(found_at[:, None] - asked[None]).max(-1)
        assert distance.min(1).max() < 1e-5
        np.testing.assert_allclose(
            part.following, recorded["next_observation"][distance.argmin(1)], atol=1e-5
        )
        ends = np.abs(part.following[:, 1]) > 0.2
        assert ends.any() and (part.terminated == ends).all()
    first = found.train.log(12, parts=2)
    assert first.steps == 12 and first.count.tolist() == [6, 6]
    np.testing.assert_allclose(first.rows()["action"], found.train.action[:12], atol=1e-6)
    # Nothing of one part is in the other.
    assert not {tuple(x) for x in found.train.observation} & {tuple(x) for x in found.held.observation}


def test_rows_closer_than_a_step_are_read_at_every_step(tmp_path):
    found = read(tmp_path, swing())
    assert found.train.size + found.held.size in (48, 49)
    for part in (found.train, found.held):
        np.testing.assert_allclose(part.following, moved(part.observation, part.action), atol=2e-5)
        np.testing.assert_allclose(part.following[:-1], part.observation[1:], atol=1e-6)
    assert not any("commands change" in note for note in found.notes)


def test_a_command_that_changes_within_a_step_counts_by_its_mean_and_is_told(tmp_path):
    log = swing(hold=1)
    found = read(tmp_path, log)
    first = int(np.abs(log["qpos"] - found.train.observation[0, :2]).sum(1).argmin())
    assert first in (0, 1)
    np.testing.assert_allclose(found.train.action[3], log["ctrl"][first + 6 : first + 8].mean(0), atol=1e-9)
    assert any(re.search(r"commands change within a step .*by \d+ %", note) for note in found.notes)


def test_velocities_that_were_not_recorded_are_estimated_and_told(tmp_path):
    log = swing()
    true = log.pop("qvel")
    found = read(tmp_path, log)
    at = np.r_[2 : found.train.size - 2]
    np.testing.assert_allclose(found.train.observation[at, 2:], true[::2][at], atol=0.35)
    assert np.abs(true[::2][at]).max() > 0.7
    assert any(note.startswith("velocities of hinge, slider were not recorded") for note in found.notes)


def test_rows_that_are_missing_are_not_bridged(tmp_path):
    log = {name: np.delete(values, np.r_[20:26], axis=0) for name, values in swing().items()}
    found = read(tmp_path, log)
    assert both(found, "episode").max() >= 1
    for part in (found.train, found.held):
        np.testing.assert_allclose(part.following, moved(part.observation, part.action), atol=2e-5)
    assert any("rows are missing in 1 places" in note for note in found.notes)


def test_joints_of_another_model_are_found_by_their_names(tmp_path):
    spec = nominal_spec(TASK)
    spec.worldbody.add_geom(name="a_part_more", size=[0.1, 0.1, 0.1])
    flag = spec.worldbody.add_body(name="flag", pos=[3, 0, 0])
    flag.add_geom(size=[0.1, 0.1, 0.1])
    flag.add_joint(name="flag", type=mujoco.mjtJoint.mjJNT_HINGE, range=[-1, 1])
    model = tmp_path / "machine.xml"
    spec.compile()
    model.write_text(spec.to_xml())
    log = swing()
    titles = ["time", "qpos:flag", "qpos:hinge", "qpos:slider", "qvel:hinge", "qvel:slider", "ctrl:slide"]
    table = [
        log["time"],
        0 * log["time"],
        log["qpos"][:, 1],
        log["qpos"][:, 0],
        log["qvel"][:, 1],
        log["qvel"][:, 0],
    ]
    lines = [",".join(titles)] + [
        ",".join(map(repr, map(float, row))) for row in zip(*table, log["ctrl"][:, 0], strict=True)
    ]
    (tmp_path / "run.csv").write_text("\n".join(lines))
    found = transitions.read([tmp_path / "run.csv"], TASK, model=model)
    np.testing.assert_allclose(
        found.train.following, moved(found.train.observation, found.train.action), atol=2e-5
    )


def test_what_does_not_fit_is_one_sentence(tmp_path):
    def refused(log: dict[str, np.ndarray]) -> str:
        with pytest.raises(InputError) as caught:
            read(tmp_path, log)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    log = swing()
    coarse = {name: values[::3] for name, values in log.items()}
    assert "its rows are 0.06 s apart and a step of the task lasts 0.04 s" in refused(coarse)
    blind = {
        **log,
        "qpos": np.where([[False, True]], np.nan, log["qpos"]),
        "qvel": np.where([[False, True]], np.nan, log["qvel"]),
    }
    assert "run: InvertedPendulum observes hinge, whose position the log does not hold" in refused(blind)
    forces = {name: values for name, values in log.items() if name != "ctrl"} | {
        "actuator_force": log["ctrl"]
    }
    assert "there are no commands ('ctrl')" in refused(forces)
    few = {name: values[:6] for name, values in log.items()}
    few["time"] = few["time"] / 10
    assert "no two rows are one step of InvertedPendulum apart (0.04 s)" in refused(few)
    other = tmp_path / "other.xml"
    other.write_text(envs.make("Hopper", "c").task.spec().to_xml())
    np.savez(
        tmp_path / "run.npz",
        **{**log, "qpos": np.zeros((100, 6)), "qvel": np.zeros((100, 6)), "ctrl": np.zeros((100, 3))},
    )
    with pytest.raises(InputError, match="the joint slider of the task is not in the model given by --model"):
        read(tmp_path, model=other)
