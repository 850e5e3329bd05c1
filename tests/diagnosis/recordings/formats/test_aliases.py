"""Names that people use for the columns of a recording, in `.npz` and `.csv` files and anywhere else."""

from __future__ import annotations

import numpy as np
import pytest

from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.recordings.formats import aliases, tables
from mpge_jax.diagnosis.recordings.reader import load_recordings
from tests.diagnosis.recordings.formats.logs import ROWS, motion


@pytest.mark.parametrize(
    ("title", "key"),
    [
        ("observation.state", "qpos"),
        ("observation.velocity", "qvel"),
        ("observation.effort", "actuator_force"),
        ("action", "ctrl"),
        ("observations/qpos", "qpos"),
        ("infos/qvel", "qvel"),
        ("obs/robot0_joint_pos", "qpos"),
        ("joint_torques", "actuator_force"),
        ("timestamp", "time"),
        ("state", None),
        ("reward", None),
        ("action_is_pad", None),
    ],
)
def test_titles_mean_what_they_do_elsewhere(title, key):
    assert aliases.meaning(title) == key


@pytest.mark.parametrize(
    ("title", "parts"),
    [
        ("observation.state.elbow.pos", ("observation.state", "elbow.pos")),
        ("action[2]", ("action", "2")),
        ("action_0", ("action", "0")),
        ("observation.state:elbow", ("observation.state", "elbow")),
        ("elbow", None),
        ("note_action", None),
        ("elbow_pos", ("positions by joint", "elbow")),
        ("left_knee_1.Velocity", ("velocities by joint", "left_knee_1")),
        ("elbow_torque", ("torques by joint", "elbow")),
        ("motor_cmd", ("commands by name", "motor")),
        ("elbow_target_pos", None),
        ("elbow_pos_cmd", ("commands by name", "elbow_pos")),
        ("_pos", None),
    ],
)
def test_titles_of_one_column_of_an_array(title, parts):
    assert aliases.split_title(title) == parts


@pytest.mark.parametrize(
    ("title", "parts"),
    [
        ("elbow_pos [deg]", ("elbow_pos", "deg")),
        ("time (ms)", ("time", "ms")),
        ("ctrl:motor[Nm]", ("ctrl:motor", "N m")),
        ("action[m]", ("action[m]", None)),
        ("action [m]", ("action", "m")),
        ("elbow [ticks]", ("elbow [ticks]", None)),
        ("elbow", ("elbow", None)),
    ],
)
def test_a_title_may_name_its_unit(title, parts):
    assert aliases.split_unit(title, {"deg", "ms", "m", "N m"}) == parts


LEROBOT = {"timestamp": "time", "observation.state": "qpos", "observation.velocity": "qvel", "action": "ctrl"}
LEROBOT |= {"observation.effort": "force"}


def test_an_npz_of_other_names_needs_no_map(tmp_path, arm):
    m = motion()
    objects = np.array([{"a": 1}], dtype=object)
    np.savez(tmp_path / "run.npz", notes=objects, **{title: m[key] for title, key in LEROBOT.items()})
    (found,) = load_recordings([tmp_path], *arm)
    for key in ("time", "qpos", "qvel", "force", "ctrl"):
        np.testing.assert_array_equal(getattr(found, key), m[key])


def _csv(path, columns):
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")


@pytest.mark.parametrize("form", ["{}[{}]", "{}_{}", "{}.{}", "{}:{}"])
def test_a_csv_of_other_names_needs_no_map(tmp_path, arm, form):
    m = motion()
    columns = {"timestamp": m["time"]}
    for title, key in list(LEROBOT.items())[1:]:
        # the last first: numbers count, not the order of the columns
        columns |= {form.format(title, i): m[key][:, i] for i in (1, 0)}
    _csv(tmp_path / "run.csv", columns)
    (found,) = load_recordings([tmp_path], *arm)
    for key in ("time", "qpos", "qvel", "force", "ctrl"):
        np.testing.assert_array_equal(getattr(found, key), m[key])


def test_columns_of_a_csv_may_carry_names_of_joints(tmp_path, arm):
    m = motion()
    columns = {"time": m["time"]}
    columns |= {
        f"observation.state.{joint}": m["qpos"][:, i] for i, joint in ((1, "elbow"), (0, "left_shoulder"))
    }
    columns |= {f"action.{joint}": m["ctrl"][:, i] for i, joint in ((1, "elbow.pos"), (0, "shoulder.pos"))}
    _csv(tmp_path / "run.csv", columns)
    (found,) = load_recordings([tmp_path], *arm)
    np.testing.assert_array_equal(found.qpos, m["qpos"])
    np.testing.assert_array_equal(found.ctrl, m["ctrl"])


def test_a_file_that_names_what_it_holds_is_read_by_these_names_alone(tmp_path, arm):
    m = motion()
    other = {"observation.velocity": 9 + m["qvel"], "action": 9 + m["ctrl"]}
    np.savez(tmp_path / "run.npz", time=m["time"], qpos=m["qpos"], ctrl=m["ctrl"], **other)
    (found,) = load_recordings([tmp_path], *arm)
    assert found.qvel is None
    np.testing.assert_array_equal(found.ctrl, m["ctrl"])


def test_a_map_comes_before_other_names(tmp_path, arm):
    m = motion()
    np.savez(tmp_path / "run.npz", t=m["time"], timestamp=np.zeros(ROWS), action=m["ctrl"], qpos=m["qpos"])
    columns = {"time": "t", "ctrl:elbow_servo": {"from": "action", "column": 0}}
    columns["ctrl:shoulder_motor"] = {"from": "action", "column": 1}
    (found,) = load_recordings([tmp_path], *arm, columns)
    np.testing.assert_array_equal(found.ctrl, m["ctrl"][:, ::-1])
    np.testing.assert_array_equal(found.time, m["time"])


def test_arrays_of_other_widths_are_told(tmp_path, arm):
    m = motion()
    np.savez(
        tmp_path / "run.npz",
        timestamp=m["time"],
        action=m["ctrl"],
        **{"observation.state": np.ones((ROWS, 5))},
    )
    with pytest.raises(InputError, match=r"no 'qpos', but .*observation\.state is not .* 5 numbers a row"):
        load_recordings([tmp_path], *arm)


def test_sizes_are_read_from_headers_here_too(tmp_path, arm, monkeypatch):
    m = motion()
    np.savez(tmp_path / "run.npz", **{title: m[key] for title, key in LEROBOT.items()})
    monkeypatch.setattr(tables, "MAX_VALUES", 2 * ROWS - 1)
    monkeypatch.setattr(np.lib.npyio.NpzFile, "__getitem__", lambda _self, key: np.zeros(ROWS))
    with pytest.raises(InputError, match="has 120 values; cut"):
        load_recordings([tmp_path], *arm)
