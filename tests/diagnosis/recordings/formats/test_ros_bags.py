"""Bags of ROS 1 and 2, as rosbags writes them and as real robots did."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.recordings.formats import tables, unpacking
from mpge_jax.diagnosis.recordings.formats.ros_types import STATE, STATES
from mpge_jax.diagnosis.recordings.reader import load_recordings, read
from tests.diagnosis.recordings.formats.logs import (
    NAMES,
    arm_messages,
    header,
    joint_state,
    motion,
    multi_array,
    stamp,
    store,
    write_ros1,
    write_ros2,
)

ROOT = Path(__file__).parents[4]
REAL = Path(os.environ.get("MPGE_RECORDINGS", ROOT.parent / "shared" / "data" / "recordings"))


def _is_the_arm(recording, rows=None):
    m = motion()
    n = recording.time.size
    assert n == len(m["time"]) if rows is None else n == rows
    np.testing.assert_allclose(recording.time - recording.time[0], m["time"][:n], atol=1e-8)
    for key in ("qpos", "qvel", "force", "ctrl"):
        np.testing.assert_allclose(getattr(recording, key), m[key][:n], atol=1e-12)


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
@pytest.mark.parametrize("how", ["folder", "without metadata", "alone", "two folders up"])
def test_a_bag_of_ros2_in_every_shape(tmp_path, arm, storage, how):
    bag = write_ros2(tmp_path / "run_1", arm_messages(store()), store(), storage)
    (part,) = (p for p in bag.iterdir() if p.suffix in (".db3", ".mcap"))
    if how != "folder":
        (bag / "metadata.yaml").unlink()
    path = {"alone": part, "two folders up": tmp_path}.get(how, bag)
    if how == "two folders up":
        shutil.move(part, tmp_path / part.name)
    (found,) = load_recordings([path], *arm)
    _is_the_arm(found)
    assert found.name.startswith("run_1")
    assert found.origin + found.time[0] == 1e9
    assert any("/arm/commands comes apart from /joint_states, by receive stamps" in w for w in found.warnings)


@pytest.mark.parametrize("compress", ["file", "message"])
def test_compressed_bags_of_ros2(tmp_path, arm, compress, monkeypatch):
    bag = write_ros2(tmp_path / "run", arm_messages(store()), store(), compress=compress)
    (found,) = load_recordings([bag], *arm)
    _is_the_arm(found)
    monkeypatch.setattr(tables, "MAX_BYTES", 100)
    monkeypatch.setattr(unpacking, "MAX_FILE", 100)
    with pytest.raises(InputError, match="unpacked"):
        load_recordings([bag], *arm)


@pytest.mark.parametrize("compress", ["", "bz2", "lz4"])
def test_a_bag_of_ros1(tmp_path, arm, compress, monkeypatch):
    types = store(ros1=True)
    path = write_ros1(tmp_path / "run.bag", arm_messages(types, ros1=True), types, compress)
    (found,) = load_recordings([path], *arm)
    _is_the_arm(found)
    if compress:
        monkeypatch.setattr(tables, "MAX_BYTES", 100)
        with pytest.raises(InputError, match="unpacked"):
            load_recordings([path], *arm)


def test_parts_of_one_bag_are_one_recording(tmp_path, arm):
    messages, folder = arm_messages(store()), tmp_path / "bag"
    folder.mkdir()
    for k in range(3):
        part = write_ros2(tmp_path / f"part{k}", messages[40 * k : 40 * (k + 1)], store())
        shutil.move(part / f"part{k}.db3", folder / f"run_{k + 8}.db3")
    (found,) = load_recordings([folder], *arm)
    _is_the_arm(found)
    assert found.name == "bag"


def test_bags_of_other_names_in_a_folder_are_recordings_of_their_own(tmp_path, arm):
    for name in ("walk", "heldout_run"):
        part = write_ros2(tmp_path / "parts" / name, arm_messages(store()), store())
        shutil.move(part / f"{name}.db3", tmp_path / f"{name}.db3")
    assert [r.name for r in load_recordings([tmp_path], *arm)] == ["heldout_run", "walk"]


def test_a_bags_metadata_leads_to_no_other_folder(tmp_path, arm):
    bag = write_ros2(tmp_path / "run", arm_messages(store()), store())
    about = bag / "metadata.yaml"
    text = about.read_text()
    about.write_text(text.replace("- run.db3", "- ../../elsewhere/run.db3"))
    # a part that is not listed belongs to another bag
    other = write_ros2(tmp_path / "other", arm_messages(store(), origin=2 * 10**18), store())
    shutil.copy(other / "other.db3", bag / "old.db3")
    _is_the_arm(*load_recordings([bag], *arm))
    about.write_text(text.replace("- run.db3", "- ../other.db3"))
    with pytest.raises(InputError, match=r"other\.db3 of the bag is not in its folder"):
        load_recordings([bag], *arm)
    for bad in ("!!python/object/apply:os.system ['true']", "a: [", "\x00"):
        about.write_text(bad)
        with pytest.raises(InputError, match=r"metadata\.yaml cannot be read"):
            load_recordings([bag], *arm)


def _states(types, changes):
    """Joint states of the arm with one thing changed in each message."""
    m, out = motion(), []
    for k in range(len(m["time"])):
        ns = 10**18 + round(m["time"][k] * 1e9)
        message = joint_state(types, ns, {key: v[k] for key, v in m.items()})
        changes(k, message, types)
        out.append(("/joint_states", ns + 5_000_000 + 1_000_000 * (k % 2), message))
    return out


def test_receive_stamps_count_where_no_header_has_a_stamp(tmp_path, arm):
    def unstamped(_k, message, types):
        message.header.stamp = stamp(types, 0)

    bag = write_ros2(tmp_path / "run", _states(store(), unstamped), store())
    (found,) = load_recordings([bag], *arm)
    steps = np.diff(found.time)
    np.testing.assert_allclose(steps, np.where(np.arange(steps.size) % 2, 0.009, 0.011), atol=1e-8)
    stamped = write_ros2(tmp_path / "stamped", _states(store(), lambda *_: None), store())
    (found,) = load_recordings([stamped], *arm)
    np.testing.assert_allclose(np.diff(found.time), 0.01, atol=1e-8)


def test_rows_are_put_in_the_order_of_their_stamps(tmp_path, arm):
    states = _states(store(), lambda *_: None)
    later = states[:10] + states[10:40][::-1] + states[40:]
    swapped = [(topic, ns, m) for (topic, ns, _), (_, _, m) in zip(states, later, strict=True)]
    bag = write_ros2(tmp_path / "run", swapped, store())
    (found,) = load_recordings([bag], *arm)
    np.testing.assert_allclose(found.qpos, motion()["qpos"])


def test_joints_in_messages_of_their_own_are_put_together(tmp_path, arm):
    def halved(k, message, _types):
        part = slice(0, 1) if k % 2 else slice(1, 2)
        message.name = NAMES[part]
        for key in ("position", "velocity", "effort"):
            setattr(message, key, getattr(message, key)[part])

    bag = write_ros2(tmp_path / "run", _states(store(), halved), store())
    (found,) = load_recordings([bag], *arm)
    m, n = motion(), found.time.size
    assert n == len(m["time"]) // 2 - 1
    # one joint's rows count, the other's are interpolated between its own
    np.testing.assert_allclose(found.qpos[:, 0], np.interp(found.time + 0.0, *_at(m, found, 0)), atol=2e-4)
    np.testing.assert_allclose(found.qpos[:, 1], np.interp(found.time + 0.0, *_at(m, found, 1)), atol=2e-4)
    assert any("is interpolated" in w for w in found.warnings)


def _at(m, found, joint):
    return m["time"] + (1e9 - found.origin), m["qpos"][:, joint]


def test_fields_that_a_message_leaves_empty_are_not_there(tmp_path, arm):
    def bare(_k, message, _types):
        message.velocity = np.zeros(0)

    bag = write_ros2(tmp_path / "run", _states(store(), bare), store())
    (found,) = load_recordings([bag], *arm)
    assert found.qvel is None
    np.testing.assert_allclose(found.force, motion()["force"])


def test_rows_that_were_sent_twice_are_left_out(tmp_path, arm):
    m = motion()

    def again(k, message, _types):
        if k in (20, 33):
            for key, source in (("position", "qpos"), ("velocity", "qvel"), ("effort", "force")):
                setattr(message, key, m[source][k - 1][::-1].copy())

    bag = write_ros2(tmp_path / "run", _states(store(), again), store())
    (found,) = load_recordings([bag], *arm)
    assert found.time.size == len(m["time"]) - 2
    assert any("2 rows repeat the reading before them" in w for w in found.warnings)


def _controller_state(types, ns, ctrl, q):
    point = types.types["trajectory_msgs/msg/JointTrajectoryPoint"]
    empty = np.zeros(0)
    duration = types.types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)

    def at(positions):
        return point(
            positions=positions, velocities=empty, accelerations=empty, effort=empty, time_from_start=duration
        )

    multi = types.types["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"]
    values = {"header": header(types, ns, False), "joint_names": ["elbow", "shoulder"]}
    for name, _ in types.fielddefs[STATE][1]:
        if name in ("reference", "desired"):
            values[name] = at(ctrl[::-1].copy())
        elif name in ("feedback", "actual"):
            values[name] = at(q[::-1].copy())
        elif name == "multi_dof_joint_names":
            values[name] = []
        elif name.startswith("multi_dof"):
            values[name] = multi(transforms=[], velocities=[], accelerations=[], time_from_start=duration)
        elif name in ("error", "output"):
            values[name] = at(empty)
        assert name in values
    return types.types[STATE](**values)


@pytest.mark.parametrize("version", range(len(STATES)))
def test_a_controllers_state_holds_commands_in_every_version_of_it(tmp_path, arm, version):
    types, m = store(version=version), motion()
    messages = []
    for k in range(len(m["time"])):
        ns = 10**18 + round(m["time"][k] * 1e9)
        messages.append(("/arm/state", ns, _controller_state(types, ns, m["ctrl"][k], m["qpos"][k])))
    bag = write_ros2(tmp_path / "run", messages, store(version=version))
    with pytest.raises(InputError, match="neither commands"):
        # the shoulder is driven by torque, so that positions are no command of it
        load_recordings([bag], *arm)
    model = compile_variable(load_spec(_servos(tmp_path)))
    (found,) = load_recordings([bag], model, names_of(model))
    np.testing.assert_allclose(found.ctrl, m["ctrl"])
    np.testing.assert_allclose(found.qpos, m["qpos"])


def _servos(folder: Path) -> Path:
    from tests.diagnosis.machines import ARM

    path = folder / "servos.xml"
    path.write_text(ARM.replace('<motor name="shoulder_motor"', '<position kp="9" name="shoulder_motor"'))
    return path


@pytest.mark.parametrize("name", ["ur10", "panda"])
def test_a_real_bag_is_what_its_standard_form_is(name):
    folder = REAL / f"{name}_bag"
    if not folder.is_dir():
        pytest.skip("the recordings of real machines are not here")
    model = compile_variable(load_spec(folder / "standard" / "model.xml"))
    (found,) = read([folder / "raw"], model, names_of(model))
    standard = read([folder / "standard"], model, names_of(model))
    standard.sort(key=lambda r: r.name.startswith("heldout"))
    for key in ("qpos", "qvel", "force"):
        whole = np.concatenate([getattr(r, key) for r in standard])
        assert getattr(found, key).shape == whole.shape
        np.testing.assert_allclose(getattr(found, key), whole, atol=1e-5)
    assert found.ctrl is None


def test_commands_in_several_forms(tmp_path, arm):
    """A torque by a number, a servo's target by a plan of one point; a plan of several is told and not read."""
    types, m, out = store(), motion(), []
    point, plan = (
        types.types["trajectory_msgs/msg/JointTrajectoryPoint"],
        types.types["trajectory_msgs/msg/JointTrajectory"],
    )
    at = types.types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
    empty = np.zeros(0)
    for k in range(len(m["time"])):
        ns = 10**18 + round(m["time"][k] * 1e9)
        row = {key: v[k] for key, v in m.items()}
        out.append(("/joint_states", ns, joint_state(types, ns, row)))
        out.append(
            ("/arm_shoulder/effort/command", ns, types.types["std_msgs/msg/Float64"](data=row["ctrl"][0]))
        )
        target = point(
            positions=row["ctrl"][1:], velocities=empty, accelerations=empty, effort=empty, time_from_start=at
        )
        out.append(("/set", ns, plan(header=header(types, 0, False), joint_names=["elbow"], points=[target])))
        out.append(
            ("/plan", ns, plan(header=header(types, 0, False), joint_names=["elbow"], points=[target] * 2))
        )
    bag = write_ros2(tmp_path / "run", out, store())
    (found,) = load_recordings([bag], *arm)
    np.testing.assert_allclose(found.ctrl, m["ctrl"])
    assert any("/plan holds 60 plans of several points" in w for w in found.warnings)


def test_topics_of_other_types_are_told_where_nothing_is_found(tmp_path, arm):
    types = store()
    pose = types.types["std_msgs/msg/String"](data="x")
    bag = write_ros2(
        tmp_path / "run", [("/talk", 1, pose), ("/arm/commands", 2, multi_array(types, [1]))], store()
    )
    with pytest.raises(
        InputError, match=r"nothing in it is recognised .*/arm/commands/data.*/talk \(std_msgs/String\)"
    ):
        load_recordings([bag], *arm)


def test_a_map_reads_a_bag(tmp_path, arm):
    bag = write_ros2(tmp_path / "run", arm_messages(store()), store())
    columns = {
        "qpos:shoulder": {"from": "/joint_states/position", "column": "arm_shoulder_joint", "unit": "deg"},
        "ctrl:elbow_servo": {"from": "/arm/commands/data", "column": 1, "scale": 10},
        "ctrl:shoulder_motor": {"from": "/arm/commands/data", "column": 0},
    }
    (found,) = load_recordings([bag], *arm, columns)
    m = motion()
    np.testing.assert_allclose(found.qpos[:, 0], np.deg2rad(m["qpos"][:, 0]))
    assert np.isnan(found.qpos[:, 1]).all()  # what a map says of positions is all that is read of them
    np.testing.assert_allclose(found.ctrl[:, 1], 10 * m["ctrl"][:, 1])
    columns["qpos:shoulder"]["column"] = "shoulder"
    with pytest.raises(InputError, match=r"needs one of arm_elbow_joint, arm_shoulder_joint.*did you mean"):
        load_recordings([bag], *arm, columns)


def test_paths_that_would_open_another_database_are_refused(tmp_path, arm):
    bag = write_ros2(tmp_path / "run", arm_messages(store()), store())
    odd = tmp_path / "run?mode=memory.db3"
    shutil.copy(bag / "run.db3", odd)
    with pytest.raises(InputError, match="one of the characters"):
        load_recordings([odd], *arm)
