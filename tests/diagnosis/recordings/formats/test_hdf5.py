"""HDF5 files in the layouts of D4RL, Minari, robomimic and ALOHA."""

from __future__ import annotations

import json

import h5py
import numpy as np
import pytest

from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.recordings.formats import tables
from mpge_jax.diagnosis.recordings.reader import load_recordings
from tests.diagnosis.recordings.formats.logs import ROWS, motion

STEP = {"time": {"step": 20, "unit": "ms"}}


def test_d4rl_is_cut_into_its_episodes(tmp_path, arm):
    m, path = motion(), tmp_path / "hopper.hdf5"
    with h5py.File(path, "w") as f:
        f["observations"] = np.ones((ROWS, 5), "float32")
        f["actions"], f["rewards"] = m["ctrl"], np.zeros(ROWS)
        f["infos/qpos"], f["infos/qvel"] = m["qpos"], m["qvel"]
        f["terminals"], f["timeouts"] = np.arange(ROWS) == 19, np.arange(ROWS) == 39
    with pytest.raises(InputError, match=r"there are no times in hopper\.hdf5; say with --map .*step"):
        load_recordings([path], *arm)
    found = load_recordings([path], *arm, STEP)
    assert [r.name for r in found] == ["hopper_0", "hopper_1", "hopper_2"]
    assert [r.time.size for r in found] == [20, 20, 20]
    np.testing.assert_allclose(np.concatenate([r.qpos for r in found]), m["qpos"])
    np.testing.assert_allclose(np.concatenate([r.ctrl for r in found]), m["ctrl"])
    np.testing.assert_allclose(found[1].time, 0.02 * np.arange(20))


@pytest.mark.parametrize("folder", [True, False])
def test_minari_has_one_observation_more_than_actions(tmp_path, arm, folder):
    m, path = motion(), tmp_path / "arm" / "data" / "main_data.hdf5"
    path.parent.mkdir(parents=True)
    with h5py.File(path, "w") as f:
        for k in (0, 2, 10):
            group = f.create_group(f"episode_{k}")
            group["observations"], group["actions"] = np.zeros((ROWS, 3)), m["ctrl"][:-1]
            group["infos/qpos"], group["infos/qvel"] = m["qpos"] + k, m["qvel"]
            group["terminations"] = np.zeros(ROWS - 1, bool)
    found = load_recordings([tmp_path / "arm" if folder else path], *arm, STEP)
    assert [r.name for r in found] == ["arm_episode_0", "arm_episode_2", "arm_episode_10"]
    for k, r in zip((0, 2, 10), found, strict=True):
        np.testing.assert_allclose(r.qpos, m["qpos"] + k)
        np.testing.assert_allclose(r.ctrl[:-1], m["ctrl"][:-1])
        np.testing.assert_array_equal(r.ctrl[-1], r.ctrl[-2])


def _robomimic(path, states=True, controller="JOINT_TORQUE"):
    m = motion()
    with h5py.File(path, "w") as f:
        data = f.create_group("data")
        arguments = {"control_freq": 25, "controller_configs": {"type": controller}}
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "env_kwargs": arguments})
        for k in range(2):
            demo = data.create_group(f"demo_{k}")
            demo["actions"] = m["ctrl"]
            if states:
                demo["states"] = np.column_stack([7 + m["time"], m["qpos"], m["qvel"]])
            else:
                demo["obs/robot0_joint_pos"], demo["obs/robot0_joint_vel"] = m["qpos"], m["qvel"]
            demo["obs/agentview_image"] = np.zeros((ROWS, 4, 4, 3), "uint8")
    return m


@pytest.mark.parametrize("states", [True, False])
def test_robomimic_has_the_state_or_joint_positions(tmp_path, arm, states):
    m = _robomimic(tmp_path / "lift.hdf5", states)
    found = load_recordings([tmp_path / "lift.hdf5"], *arm)
    assert [r.name for r in found] == ["lift_demo_0", "lift_demo_1"]
    for key in ("qpos", "qvel", "ctrl"):
        np.testing.assert_allclose(getattr(found[0], key), m[key])
    np.testing.assert_allclose(found[0].time, 7 + m["time"] if states else np.arange(ROWS) / 25)
    assert states or any("made up from the rate" in w for w in found[0].warnings)


def test_actions_of_a_hand_are_no_commands_of_joints(tmp_path, arm):
    """As many numbers as joints, but what the controller is told is where the hand goes."""
    _robomimic(tmp_path / "lift.hdf5", controller="OSC_POSE")
    with pytest.raises(InputError, match="neither commands"):
        load_recordings([tmp_path / "lift.hdf5"], *arm)


def test_aloha_and_contract_names(tmp_path, arm):
    m = motion()
    with h5py.File(tmp_path / "episode_0.hdf5", "w") as f:
        f["observations/qpos"], f["observations/qvel"], f["observations/effort"] = (
            m["qpos"],
            m["qvel"],
            m["force"],
        )
        f["action"] = m["ctrl"]
    with h5py.File(tmp_path / "run.h5", "w") as f:
        for key in ("time", "qpos", "qvel", "ctrl"):
            f[key] = m[key]
        f["actuator_force"] = m["force"]
    (a,) = load_recordings([tmp_path / "episode_0.hdf5"], *arm, STEP)
    (b,) = load_recordings([tmp_path / "run.h5"], *arm)
    for key in ("qpos", "qvel", "force", "ctrl"):
        np.testing.assert_allclose(getattr(a, key), m[key])
        np.testing.assert_allclose(getattr(b, key), m[key])
    np.testing.assert_allclose(b.time, m["time"])


def test_what_lies_in_other_files_is_not_read(tmp_path, arm):
    m = motion()
    with h5py.File(tmp_path / "other.h5", "w") as f:
        f["qpos"] = m["qpos"]
    for kind in ("link", "virtual", "external"):
        path = tmp_path / f"{kind}.h5"
        with h5py.File(path, "w") as f:
            f["time"], f["ctrl"] = m["time"], m["ctrl"]
            if kind == "link":
                f["qpos"] = h5py.ExternalLink("other.h5", "/qpos")
            elif kind == "virtual":
                layout = h5py.VirtualLayout(m["qpos"].shape, "float64")
                layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "qpos", m["qpos"].shape)
                f.create_virtual_dataset("qpos", layout)
            else:
                f.create_dataset("qpos", m["qpos"].shape, "float64", external=[("/etc/passwd", 0, 960)])
        with pytest.raises(InputError, match=r"other file|another file"):
            load_recordings([path], *arm)


def test_sizes_are_read_before_the_numbers(tmp_path, arm, monkeypatch):
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as f:
        f.create_dataset("qpos", (10**12, 2), "float64", chunks=(1000, 2), compression="gzip")
        f["time"] = np.zeros(3)
    assert path.stat().st_size < 20_000
    with pytest.raises(InputError, match=r"'qpos' has 2000000000000 values; cut"):
        load_recordings([path], *arm)
    with h5py.File(path, "w") as f:
        f.create_dataset("qpos", (5, 2), "float64", chunks=(10**6, 2), maxshape=(None, 2), compression="gzip")
    monkeypatch.setattr(tables, "MAX_BYTES", 10**6)
    with pytest.raises(InputError, match="unpacked"):
        load_recordings([path], *arm)


def test_groups_that_hold_themselves_end(tmp_path, arm):
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as f:
        f["a/b"] = h5py.SoftLink("/a")
        f["time"] = np.zeros(3)
    with pytest.raises(InputError, match="deep"):
        load_recordings([path], *arm)
