"""Readers and validation: one clear sentence for each kind of bad input, and no crash on any bytes."""

import io
import os
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mpge_jax.diagnosis import InputError, Recording
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.recordings.checks import check_model
from mpge_jax.diagnosis.recordings.column_map import content, load
from mpge_jax.diagnosis.recordings.reader import load_recordings, read_recording
from mpge_jax.diagnosis.recordings.recording import chain_transitions
from mpge_jax.diagnosis.recordings.rows.full_turns import unwrapped
from mpge_jax.diagnosis.recordings.validation import validate
from tests.diagnosis.machines import ARM, PENDULUM


@pytest.fixture(scope="module")
def arm():
    import mujoco

    model = compile_variable(mujoco.MjSpec.from_string(ARM))
    return model, names_of(model)


def _arrays(rows=20):
    t = 0.01 * np.arange(rows)
    q = np.stack([np.sin(t), np.cos(t)], 1)
    return {"time": t, "qpos": q, "ctrl": np.zeros((rows, 2))}


def _save(folder: Path, **changes) -> Path:
    data = {k: v for k, v in {**_arrays(), **changes}.items() if v is not None}
    path = folder / "run.npz"
    np.savez(path, **data)
    return path


def test_npz_and_csv_give_the_same_recording(tmp_path, arm):
    a = read_recording(_save(tmp_path), *arm)
    data = _arrays()
    table = np.column_stack([data["time"], data["qpos"], data["ctrl"]])
    titles = "time,qpos:shoulder,qpos:elbow,ctrl:shoulder_motor,ctrl:elbow_servo"
    path = tmp_path / "run.csv"
    np.savetxt(path, table, delimiter=",", header=titles, comments="", fmt="%.17g")
    b = read_recording(path, *arm)
    np.testing.assert_array_equal(a.qpos, b.qpos)
    np.testing.assert_array_equal(a.ctrl, b.ctrl)
    np.testing.assert_array_equal(a.time, b.time)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": np.zeros(20)}, r"most rows have the time of the row before \(0 at first\); save"),
        ({"time": 1.7e9 + np.zeros(20)}, r"seconds since 1970 need double precision"),
        ({"time": -0.01 * np.arange(20)}, "runs backwards at row 1, 0 s after the first row, by 0.01 s"),
        (
            {"time": 1732366800.0 + np.r_[0.0, 0.01, 0.009, 0.01 * np.arange(3, 20)]},
            "runs backwards at row 2, 0.01 s after the first row, by 0.001",
        ),
        (
            {"qpos": np.r_[[[1e200, 0.0]], np.zeros((19, 2))]},
            r"'qpos' of shoulder is 1e\+200, which no machine does",
        ),
        (
            {"ctrl": np.r_[[[0.0, -1e12]], np.zeros((19, 2))]},
            r"'ctrl' of elbow_servo is -1e\+12, which no machine",
        ),
        ({"time": np.r_[0, 0, 0.01 * np.arange(1, 19)]}, "repeats at row 1"),
        ({"time": np.r_[np.nan, 0.01 * np.arange(1, 20)]}, "not finite at row 0"),
        ({"qpos": np.zeros((20, 3))}, r"'qpos' has 3 columns but the model needs 2 \(shoulder, elbow\)"),
        ({"ctrl": np.zeros((20, 1))}, r"'ctrl' has 1 columns but .* 2 \(shoulder_motor, elbow_servo\)"),
        ({"ctrl": np.zeros((19, 2))}, r"'ctrl' has shape \(19, 2\), but 'time' has 20 rows"),
        ({"qpos": np.full((20, 2), np.nan)}, "no position was measured"),
        ({"qpos": np.r_[[[np.inf, 0.0]], np.zeros((19, 2))]}, "'qpos' of shoulder is infinite at row 0"),
        ({"qpos": np.r_[[[0.0, np.nan]], np.zeros((19, 2))]}, "'qpos' of elbow is NaN at row 0"),
        ({"ctrl": np.full((20, 2), np.nan)}, "there are neither commands"),
        ({"ctrl": np.tile([np.nan, 0.1], (20, 1))}, "'ctrl' of shoulder_motor was not recorded"),
        ({"ctrl": np.r_[[[0.0, np.nan]], np.zeros((19, 2))]}, "'ctrl' of elbow_servo is NaN at row 0"),
        ({"time": 10.0 * np.arange(20)}, r"rows are 10 s apart, .* times are in seconds \(a map"),
        ({"ctrl": None}, "neither commands"),
        ({"qpos": None}, "there is no 'qpos'.*--map"),
        ({"qpos": np.full((20, 2), "x")}, "does not hold numbers"),
    ],
)
def test_bad_npz_is_told_in_one_sentence(tmp_path, arm, changes, message):
    with pytest.raises(InputError, match=message) as caught:
        read_recording(_save(tmp_path, **changes), *arm)
    assert "\n" not in str(caught.value)
    assert "run" in str(caught.value)


def test_pickles_are_never_loaded(tmp_path, arm):
    path = tmp_path / "run.npz"
    np.savez(path, time=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match="pickled"):
        read_recording(path, *arm)


def test_unknown_csv_column_names_what_is_known(tmp_path, arm):
    path = tmp_path / "run.csv"
    path.write_text("time,qpos:wrist\n0,1\n1,2\n")
    with pytest.raises(InputError, match=r"qpos:wrist.*shoulder, elbow"):
        read_recording(path, *arm)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "no rows below the header"),
        ("time,qpos:elbow\n", "no rows below the header"),
        ("time;qpos:elbow\n0;1\n", "separated by semicolons; save it with commas"),
        ("time,qpos:elbow\n0,1\n\n1\n", "line 4 has 1 cells, but the header has 2 columns"),
        ("time,qpos:elbow\n0,1\n1,up\n", "'up' in column 'qpos:elbow', line 3, is no number"),
        ("time,qpos:elbow,qpos:elbow\n0,1,1\n", "'qpos:elbow' appears twice"),
        ("t,q\n0,1\n", "there is no 'time', but t, q; .*--map"),
        ("time\tqpos:elbow\n0\t1\n", "separated by tabs; save it with commas"),
        ("0,1\n0.01,1\n", "the first line holds numbers; it has to name the columns"),
        ("time,elbow_deg\n0,1\n1,2\n", "there is no 'qpos:JOINT', but time, elbow_deg; .*--map.*inspect"),
        ("time,elbow_target_pos\n0,1\n1,2\n", "there is no 'qpos:JOINT'"),
        ("time,qpos:elbow [turns]\n0,1\n1,2\n", r"'qpos:elbow \[turns\]' names nothing in the model"),
        ("time,qpos:elbow,Größe\n0,1,2\n", "not UTF-8 text"),
    ],
)
def test_bad_csv_is_told_in_one_sentence(tmp_path, arm, content, message):
    path = tmp_path / "run.csv"
    path.write_bytes(content.encode("latin-1"))
    with pytest.raises(InputError, match=message) as caught:
        read_recording(path, *arm)
    assert "\n" not in str(caught.value) and "run.csv" in str(caught.value)


@pytest.mark.parametrize(
    "header",
    [
        "time [ms],qpos:shoulder [deg],qpos:elbow [rad],ctrl:shoulder_motor [N m],ctrl:elbow_servo",
        "# recorded on a Monday\n# Time [ms],shoulder_pos [deg],elbow.position,shoulder_cmd,elbow_cmd",
    ],
)
def test_a_title_may_name_its_unit_and_say_of_what_joint_it_is(tmp_path, arm, header):
    path = tmp_path / "run.csv"
    path.write_text(f"{header}\n0,90,1,3,4\n10,180,2,5,6\n")
    r = read_recording(path, *arm)
    np.testing.assert_allclose(r.time, [0.0, 0.01])
    np.testing.assert_allclose(r.qpos, [[np.pi / 2, 1.0], [np.pi, 2.0]])
    np.testing.assert_array_equal(r.ctrl, [[3, 4], [5, 6]])
    assert not any("not read" in w for w in r.warnings)


def test_columns_by_joint_count_where_no_array_of_another_name_is(tmp_path, arm):
    path = tmp_path / "run.csv"
    path.write_text(
        "timestamp,observation.state.shoulder,observation.state.elbow,action[0],action[1],elbow_pos,elbow_vel\n"
        "0,1,2,3,4,90,91\n1,5,6,7,8,92,93\n"
    )
    r = read_recording(path, *arm)
    np.testing.assert_array_equal(r.qpos, [[1, 2], [5, 6]])
    np.testing.assert_array_equal(r.qvel[:, 1], [91, 93])


def test_columns_that_are_not_read_are_told_where_a_joint_lacks_its_positions(tmp_path, arm):
    path = tmp_path / "run.csv"
    path.write_text("time,qpos:shoulder,q_elbow,ctrl:shoulder_motor,ctrl:elbow_servo\n0,1,2,3,4\n1,2,3,4,5\n")
    said = read_recording(path, *arm).warnings
    assert said[0] == (
        "run: there are no positions of elbow, and q_elbow is not read; if they are there under another name, call "
        "them 'qpos:elbow' or give a map."
    )


def test_columns_of_other_meaning_may_hold_anything(tmp_path, arm):
    path = tmp_path / "run.csv"
    titles = "mode,time,qpos:shoulder,qpos:elbow,ctrl:shoulder_motor,ctrl:elbow_servo,mode"
    path.write_text(f"{titles}\nauto,0,1,2,3,4,x\nmanual,1,5,6,7,8,y\n")
    r = read_recording(path, *arm)
    np.testing.assert_array_equal(r.qpos, [[1, 2], [5, 6]])
    np.testing.assert_array_equal(r.ctrl, [[3, 4], [7, 8]])


def test_folder_with_other_files(tmp_path, arm):
    _save(tmp_path)
    (tmp_path / "notes.txt").write_text("hello")
    assert [r.name for r in load_recordings([tmp_path], *arm)] == ["run"]
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match=r"no \.npz or \.csv"):
        load_recordings([empty], *arm)
    with pytest.raises(InputError, match="does not exist"):
        load_recordings([tmp_path / "nothing.npz"], *arm)


def test_warnings_for_gaps_and_commands_outside(arm):
    import mujoco

    model = compile_variable(mujoco.MjSpec.from_string(PENDULUM))
    t = np.r_[0.01 * np.arange(50), 2 + 0.01 * np.arange(50)]
    q = np.sin(3 * t)[:, None]
    r = validate(Recording("run", t, q, None, np.full((100, 1), 5.0)), model, names_of(model))
    text = " ".join(r.warnings)
    assert "gap" in text and "ctrlrange" in text


@pytest.mark.parametrize(
    ("drive", "degrees", "told"),
    [("", True, True), ("", False, False), ("motor", True, False), ("position", True, True)],
)
def test_what_goes_many_turns_there_and_back_looks_like_degrees(drive, degrees, told):
    """A wheel turns on, and where motors drive it, `check_units` knows more."""
    drive = f'<actuator><{drive} joint="turn"/></actuator>' if drive else ""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody><body><joint name="turn" axis="0 1 0"/>
    <geom size=".1"/></body></worldbody>{drive}</mujoco>""")
    time = 0.01 * np.arange(500)
    angle = 80.0 * np.sin(3.0 * time) if degrees else 40.0 * time
    given = Recording("swings", time, angle[:, None], None, np.zeros((500, model.nu)))
    said = [w for w in validate(given, model, names_of(model)).warnings if "degrees" in w]
    assert said == ["swings: positions of turn look like degrees; radians are needed."] * told


def test_a_model_without_actuators_is_warned_of(arm):
    without = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    said = []
    check_model(*arm, said)
    assert not said
    check_model(without, names_of(without), said)
    assert said[0].startswith("the model has no actuators, so that the machine is taken to move by itself")


def _turning(seconds: float):
    """A free body that turns, its quaternions as MuJoCo has them, and its velocities [T, 6]."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body name='box'><freejoint name='root'/><geom size='.1 .2 .3' type='box'/></body>"
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qvel[3:] = 1.0, -2.0, 3.0
    rows = []
    while data.time < seconds:
        rows.append((data.time, data.qpos.copy(), data.qvel.copy()))
        mujoco.mj_step(model, data)
    time, qpos, qvel = map(np.array, zip(*rows, strict=True))
    return model, time, qpos, qvel


def test_the_order_of_quaternions_is_told_by_how_they_turn():
    model, time, qpos, qvel = _turning(0.5)
    names = names_of(model)
    validate(Recording("run", time, qpos, qvel), model, names)
    last = np.concatenate([qpos[:, :3], np.roll(qpos[:, 3:], -1, axis=1)], axis=1)
    with pytest.raises(InputError, match=r"the quaternion of root turns as .* x y z w; give it as w x y z"):
        validate(Recording("run", time, last, qvel), model, names)
    # nothing tells it without velocities
    validate(Recording("run", time, last), model, names)


def test_quaternions_must_be_unit():
    import mujoco

    xml = '<mujoco><worldbody><body><freejoint name="root"/><geom size=".1"/></body></worldbody></mujoco>'
    model = compile_variable(mujoco.MjSpec.from_string(xml))
    qpos = np.zeros((5, 7))
    qpos[:, 3] = 2.0
    with pytest.raises(InputError, match="length 2"):
        validate(Recording("run", np.arange(5.0), qpos), model, names_of(model))
    qpos[:, 3] = [1, -1, 1, -1, 1]
    flipped = validate(Recording("run", np.arange(5.0), qpos), model, names_of(model))
    assert (flipped.qpos[:, 3] == 1).all()


def test_transitions_are_chained_into_episodes():
    pairs = [
        Recording(f"{i:03d}", np.array([0.0, 0.1]), np.array([[i], [i + 1.0]]), None, np.array([[i], [i]]))
        for i in range(3)
    ]
    other = Recording("other", np.array([0.0, 0.1]), np.array([[9.0], [9.5]]), None, np.zeros((2, 1)))
    chained = chain_transitions([*pairs, other])
    assert [r.time.size for r in chained] == [4, 2]
    np.testing.assert_allclose(chained[0].time, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(chained[0].qpos[:, 0], [0, 1, 2, 3])
    np.testing.assert_array_equal(chained[0].ctrl[:, 0], [0, 1, 2, 2])


def test_includes_stay_inside_the_folder(tmp_path):
    (tmp_path / "secret.xml").write_text("<mujoco/>")
    inner = tmp_path / "inner"
    inner.mkdir()
    path = inner / "model.xml"
    path.write_text('<mujoco><include file="../secret.xml"/></mujoco>')
    with pytest.raises(InputError, match="outside of the model's folder"):
        load_spec(path)
    path.write_text("<mujoco>")
    with pytest.raises(InputError, match="not well-formed"):
        load_spec(path)
    with pytest.raises(InputError, match="does not exist"):
        load_spec(tmp_path / "none.xml")


def test_models_inside_models_stay_inside_the_folder(tmp_path):
    (tmp_path / "secret.xml").write_text("<mujoco/>")
    inner = tmp_path / "inner"
    inner.mkdir()
    path, part = inner / "model.xml", inner / "part.xml"
    path.write_text(
        '<mujoco><asset><model name="part" file="part.xml"/></asset><worldbody><body><joint/><geom size=".1"/>'
        '<attach model="part" body="b" prefix="p"/></body></worldbody></mujoco>'
    )
    body = '<worldbody><body name="b"><geom size=".1"/></body></worldbody></mujoco>'
    part.write_text(f"<mujoco>{body}")
    assert load_spec(path).compile().nbody == 3
    part.write_text(f'<mujoco><include file="../secret.xml"/>{body}')
    with pytest.raises(InputError, match=r"part\.xml.*outside of the model's folder"):
        load_spec(path)


@pytest.mark.parametrize("name", ["../../secret.stl", "package://../../secret.stl", "/etc/secret.stl"])
def test_meshes_of_a_urdf_stay_inside_the_folder(tmp_path, name):
    path = tmp_path / "robot.urdf"
    mesh = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    path.write_text(f'<robot name="r"><link name="a">{mesh}</link></robot>')
    with pytest.raises(InputError, match="outside of the model's folder"):
        load_spec(path)


TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def _urdf(*meshes):
    """A pendulum whose link has these meshes."""
    shapes = "".join(f'<collision><geometry><mesh filename="{m}"/></geometry></collision>' for m in meshes)
    inertia = '<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>'
    return (
        f'<robot name="r"><link name="base"/><link name="rod">{shapes}<inertial><mass value="1"/>{inertia}</inertial>'
        '</link><joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>'
        "</joint></robot>"
    )


@pytest.mark.parametrize("package", [True, False])
@pytest.mark.parametrize(
    "name", ["package://my_robot/meshes/a.obj", "../meshes/a.obj", "file://{}/meshes/a.obj"]
)
def test_meshes_of_a_ros_package_are_found(tmp_path, name, package):
    home = tmp_path / "my_robot"
    for part in ("urdf", "meshes/visual"):
        (home / part).mkdir(parents=True)
    if package:
        (home / "package.xml").write_text("<package/>")
    (home / "meshes" / "a.obj").write_text(TETRAHEDRON)
    # another mesh of the same name, twice as large
    (home / "meshes" / "visual" / "a.obj").write_text(TETRAHEDRON.replace(".1", ".2"))
    name = name.format(home)
    path = home / "urdf" / "robot.urdf"
    path.write_text(_urdf(name, name.replace("meshes/", "meshes/visual/")))
    spec = load_spec(path)
    model = spec.copy().compile()
    assert model.nmesh == 2 and model.njnt == 1
    meshes = [model.mesh_vert[a : a + 4] for a in model.mesh_vertadr]
    edges = sorted(np.linalg.norm(v[:, None] - v, axis=-1).max() for v in meshes)
    np.testing.assert_allclose(edges, [0.1 * 2**0.5, 0.2 * 2**0.5], rtol=1e-5)


@pytest.mark.parametrize("name", ["package://other/a.dae", "../meshes/a.dae", "none.stl"])
def test_shapes_of_a_urdf_that_are_only_seen_need_not_be_there(tmp_path, name):
    path = tmp_path / "robot.urdf"
    seen = f'<visual><geometry><mesh filename="{name}"/></geometry></visual><inertial>'
    path.write_text(_urdf().replace("<inertial>", seen))
    assert load_spec(path).compile().njnt == 1


def test_models_with_meshes_beside_their_folder_can_be_written(tmp_path):
    from types import SimpleNamespace

    from mpge_jax.diagnosis.corrected.mjcf import write_models
    from mpge_jax.diagnosis.estimation.estimate import NOTHING

    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "a.obj").write_text(TETRAHEDRON)
    (tmp_path / "urdf").mkdir()
    (tmp_path / "urdf" / "robot.urdf").write_text(_urdf("../meshes/a.obj"))
    asset = '<mujoco><compiler meshdir="../meshes"/><asset><mesh name="a" file="a.obj"/></asset>'
    body = '<worldbody><body><joint/><geom type="mesh" mesh="a"/></body></worldbody></mujoco>'
    (tmp_path / "urdf" / "robot.xml").write_text(asset + body)
    for name in ("robot.urdf", "robot.xml"):
        given = SimpleNamespace(spec=load_spec(tmp_path / "urdf" / name))
        out = tmp_path / f"out_{name}"
        write_models(
            SimpleNamespace(prepared=given, fit=NOTHING, ctx=None, actuators=None, residual=None), out
        )
        import mujoco

        assert mujoco.MjModel.from_xml_path(str(out / "corrected.xml")).nmesh == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        # a folder beside the model's, and from there one further up
        (
            '<mujoco><compiler meshdir=".."/><asset><mesh file="../secret.obj"/></asset></mujoco>',
            "outside of the model's folder",
        ),
        ('<mujoco><asset><mesh file="../secret.txt"/></asset></mujoco>', "outside of the model's folder"),
        ('<mujoco><include file="../beside.xml"/></mujoco>', "outside of the model's folder"),
        ('<mujoco><include file="../beside.obj"/></mujoco>', "outside of the model's folder"),
        (_urdf("../link.obj"), "outside of the model's folder"),
        (_urdf("package://my_robot/meshes/none.stl"), "'package://my_robot/meshes/none.stl' is not in"),
        (_urdf("package://my_robot/meshes/a.dae"), r"cannot read the mesh .*a\.dae; convert it"),
    ],
)
def test_what_lies_beside_a_model_is_data_or_refused(tmp_path, text, message):
    (tmp_path / "secret.obj").write_text(TETRAHEDRON)
    home = tmp_path / "my_robot"
    (home / "urdf").mkdir(parents=True)
    for name in ("secret.txt", "beside.xml", "beside.obj"):
        (home / name).write_text("<mujoco/>")
    (home / "link.obj").symlink_to(tmp_path / "secret.obj")
    path = home / "urdf" / ("robot.urdf" if "<robot" in text else "robot.xml")
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_spec(path)
    assert "\n" not in str(caught.value)


def test_size_is_read_from_the_header_before_the_array_is_loaded(tmp_path, arm, monkeypatch):
    from mpge_jax.diagnosis.recordings.formats import tables

    path = _save(tmp_path)
    monkeypatch.setattr(tables, "MAX_VALUES", 39)
    monkeypatch.setattr(np.lib.npyio.NpzFile, "__getitem__", lambda _self, key: np.zeros(20))
    with pytest.raises(InputError, match=r"'qpos' has 40 values; cut the recording"):
        read_recording(path, *arm)


def test_a_table_that_is_too_long_is_told(tmp_path, arm, monkeypatch):
    from mpge_jax.diagnosis.recordings.formats import csv_table

    monkeypatch.setattr(csv_table, "MAX_VALUES", 5)
    path = tmp_path / "run.csv"
    path.write_text("time,qpos:elbow\n" + "0,1\n" * 3)
    with pytest.raises(InputError, match="more than 5 values; cut the recording"):
        read_recording(path, *arm)


def test_mapped_columns_may_stand_beside_text(tmp_path, arm):
    path = tmp_path / "run.csv"
    path.write_text("mode,t,a,b,u\nauto,0,90,1,3\nauto,500,180,2,4\n")
    columns = {
        "time": {"from": "t", "unit": "ms"},
        "qpos:shoulder": {"from": "a", "unit": "deg"},
        "qpos:elbow": "b",
        "ctrl:shoulder_motor": "u",
        "ctrl:elbow_servo": "u",
    }
    r = read_recording(path, *arm, columns)
    np.testing.assert_allclose(r.time, [0.0, 0.5])
    np.testing.assert_allclose(r.qpos, [[np.pi / 2, 1.0], [np.pi, 2.0]])
    np.testing.assert_array_equal(r.ctrl, [[3, 3], [4, 4]])


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=400))
def test_any_bytes_give_a_recording_or_one_sentence(tmp_path_factory, data):
    import mujoco

    model = compile_variable(mujoco.MjSpec.from_string(ARM))
    folder = tmp_path_factory.mktemp("bytes")
    for name in ("run.npz", "run.csv"):
        path = folder / name
        path.write_bytes(data)
        with pytest.raises(InputError) as caught:
            read_recording(path, model, names_of(model))
        assert "\n" not in str(caught.value)


@settings(max_examples=40, deadline=None)
@given(cut=st.integers(0, 2000), flip=st.integers(0, 2000), value=st.integers(0, 255))
def test_damaged_archives_never_crash(tmp_path_factory, cut, flip, value):
    import mujoco

    model = compile_variable(mujoco.MjSpec.from_string(ARM))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **_arrays())
    data = bytearray(buffer.getvalue())
    data[flip % len(data)] = value
    path = tmp_path_factory.mktemp("damaged") / "run.npz"
    path.write_bytes(bytes(data[: max(1, len(data) - cut % 50)]))
    try:
        r = read_recording(path, model, names_of(model))
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert r.qpos.shape == (20, 2)


def test_a_map_is_given_as_its_file_or_what_that_holds(tmp_path):
    entries = {"time": {"from": "t_ms", "unit": "ms"}}
    (tmp_path / "map.yaml").write_text("columns:\n  time: {from: t_ms, unit: ms}\n")
    for form in (tmp_path / "map.yaml", str(tmp_path / "map.yaml"), {"columns": entries}, entries):
        assert content(form) == entries
    assert content(None) is None
    # a column of that name is an entry like any other
    assert content({"columns": {"from": "x"}}) == {"columns": {"from": "x"}}
    with pytest.raises(InputError, match="a map of columns is a file or a dict"):
        content(["t_ms"])


def test_a_map_reads_beside_whole_numbers_and_what_it_does_not_name(tmp_path, arm):
    """Encoder counts are whole numbers; what is put beside them is not."""
    counts = np.stack([np.arange(20), np.arange(20)], 1)
    path = _save(tmp_path, qpos=counts, q_deg=np.full(20, 30.0), notes=np.array([{"a": 1}], dtype=object))
    r = read_recording(path, *arm, {"qpos:elbow": {"from": "q_deg", "unit": "deg"}})
    np.testing.assert_allclose(r.qpos[:, 1], np.pi / 6)
    np.testing.assert_array_equal(r.qpos[:, 0], counts[:, 0])
    with pytest.raises(InputError, match="'notes'"):
        read_recording(path, *arm, {"qpos:elbow": "notes"})


def test_titles_in_a_map_may_be_numbers_and_bad_entries_are_told(tmp_path, arm):
    path = tmp_path / "run.csv"
    path.write_text("time,1,ctrl:shoulder_motor,ctrl:elbow_servo\n0,1,3,4\n1,5,7,8\n")
    r = read_recording(path, *arm, {"qpos:elbow": {"from": 1}})
    np.testing.assert_array_equal(r.qpos[:, 1], [1, 5])
    with pytest.raises(InputError, match=r"'\['deg'\]' of 'qpos:elbow' is no unit of angle"):
        read_recording(path, *arm, {"qpos:elbow": {"from": 1, "unit": ["deg"]}})
    with pytest.raises(InputError, match="not in the file"):
        read_recording(path, *arm, {"qpos:elbow": {"from": ["1"]}})
    (tmp_path / "map.yaml").write_text("columns: {time: t}\nwritten: 2020-13-45\n")
    with pytest.raises(InputError, match=r"map\.yaml is not valid YAML"):
        load(tmp_path / "map.yaml")


def test_names_of_files_need_not_be_text(tmp_path, arm):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/fl\xfcgel.npz"))
    path.write_bytes(_save(tmp_path).read_bytes())
    assert read_recording(path, *arm).name == "fl\ufffdgel"


def test_commands_that_are_nan_throughout_were_not_recorded(tmp_path, arm):
    """As the column of any other quantity, where forces were measured."""
    path = _save(tmp_path, ctrl=np.full((20, 2), np.nan), actuator_force=np.ones((20, 2)))
    r = read_recording(path, *arm)
    assert r.ctrl is None and r.force is not None


def test_a_single_column_may_be_a_plain_array(tmp_path):
    model = compile_variable(mujoco.MjSpec.from_string(PENDULUM))
    t = 0.01 * np.arange(20)
    given = Recording("a", t, np.sin(t), np.cos(t), 0 * t)
    np.savez(tmp_path / "a.npz", time=t, qpos=given.qpos, qvel=given.qvel, ctrl=given.ctrl)
    read = read_recording(tmp_path / "a.npz", model, names_of(model))
    checked = validate(given, model, names_of(model))
    for key in ("qpos", "qvel", "ctrl"):
        assert getattr(checked, key).shape == (20, 1)
        np.testing.assert_array_equal(getattr(read, key), getattr(checked, key))


def test_lists_are_arrays(arm):
    r = validate(Recording("run", [0.0, 0.1], [[0, 0], [1, 1]], None, [[0, 0], [0, 0]]), *arm)
    assert r.qpos.shape == r.ctrl.shape == (2, 2)


def test_a_map_renames_titles_of_the_contracts_form(tmp_path, arm):
    path = tmp_path / "run.csv"
    path.write_text(
        "time,qpos:shoulder,qpos:wrist,ctrl:shoulder_motor,ctrl:elbow_servo\n0,1,2,3,4\n1,5,6,7,8\n"
    )
    r = read_recording(path, *arm, {"qpos:elbow": "qpos:wrist"})
    np.testing.assert_array_equal(r.qpos, [[1, 2], [5, 6]])


def test_a_linked_recording_keeps_the_name_of_the_link(tmp_path, arm):
    store = tmp_path / "store"
    store.mkdir()
    target = _save(store).rename(store / "abc123")
    (tmp_path / "heldout_1.npz").symlink_to(target)
    (tmp_path / "again.npz").symlink_to(target)
    # the same file twice is one recording
    assert [r.name for r in load_recordings([tmp_path], *arm)] == ["again"]
    (tmp_path / "again.npz").unlink()
    assert [r.name for r in load_recordings([tmp_path], *arm)] == ["heldout_1"]


@pytest.mark.parametrize(("xml_range", "continuous"), [("", True), ('limited="true" range="-4 4"', False)])
def test_angles_that_wrap_are_made_continuous(xml_range, continuous):
    import mujoco

    xml = PENDULUM.replace('name="hinge"', f'name="hinge" {xml_range}')
    model = compile_variable(mujoco.MjSpec.from_string(xml))
    t = 0.01 * np.arange(200)
    q = (5 * t)[:, None]
    wrapped = (q + np.pi) % (2 * np.pi) - np.pi
    r = unwrapped(Recording("run", t, wrapped, None, np.zeros((200, 1))), model, names_of(model))
    if continuous:
        np.testing.assert_allclose(r.qpos, q, atol=1e-12)
        assert any("wraps at a full turn" in w for w in r.warnings)
    else:
        np.testing.assert_array_equal(r.qpos, wrapped)


def test_angles_that_turn_far_are_left_alone():
    import mujoco

    model = compile_variable(mujoco.MjSpec.from_string(PENDULUM))
    t = 0.2 * np.arange(50)
    # more than a turn altogether, and fast: half a turn from row to row
    for q in (20 * np.sin(t), 3.0 * (np.arange(50) % 2)):
        r = unwrapped(Recording("run", t, q[:, None], None, np.zeros((50, 1))), model, names_of(model))
        np.testing.assert_array_equal(r.qpos[:, 0], q)


def test_velocities_tell_whether_an_angle_wrapped():
    import mujoco

    model = compile_variable(mujoco.MjSpec.from_string(PENDULUM))
    t = np.array([0.0, 0.25])
    for q, v, true in (
        ([-2.0, 3.5], 22.0, 3.5),
        ([3.0, -3.0], 1.1, 2 * np.pi - 3.0),
        ([3.0, -3.0], -24.0, -3.0),
    ):
        r = Recording("run", t, np.array(q)[:, None], np.full((2, 1), v), np.zeros((2, 1)))
        assert unwrapped(r, model, names_of(model)).qpos[1, 0] == pytest.approx(true)
    # nothing tells, nothing is changed
    alone = Recording("run", t, np.array([[3.0], [-3.0]]), None, np.zeros((2, 1)))
    assert unwrapped(alone, model, names_of(model)) is alone


def test_a_bad_number_is_told_by_its_line_in_the_file(tmp_path, arm):
    path = tmp_path / "run.csv"
    path.write_text("time,qpos:shoulder,qpos:elbow\n0,1,2\n\n0.01,inf,2\n0.02,1,2\n")
    with pytest.raises(InputError, match="'qpos' of shoulder is infinite at line 4"):
        read_recording(path, *arm)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"time": {"from": "t", "unit": "deg"}}, r"'deg' of 'time' is no unit of time \(known: s, ms"),
        ({"qpos:elbow": {"from": "q", "unit": "mm"}}, r"'mm' of 'qpos:elbow' is no unit of angle"),
        (
            {"qvel:elbow": {"from": "q", "unit": "deg"}},
            r"is no unit of angular velocity \(known: rad/s, deg/s, rpm\)",
        ),
        (
            {"ctrl:elbow_servo": {"from": "q", "unit": "ms"}},
            "'ms' of 'ctrl:elbow_servo' is no unit of angle",
        ),
        ({"qpos:elbow": {"from": "q", "scal": 2}}, "unknown entry 'scal'; did you mean 'scale'"),
        ({"qpos:elbwo": "q"}, r"names nothing in the model; did you mean 'qpos:elbow'.*qpos:shoulder"),
    ],
)
def test_a_map_says_what_is_wrong_with_it(tmp_path, arm, columns, message):
    path = tmp_path / "run.npz"
    np.savez(path, time=0.01 * np.arange(20), qpos=np.zeros((20, 2)), t=np.arange(20.0), q=np.ones(20))
    with pytest.raises(InputError, match=message):
        read_recording(path, *arm, columns)


def test_units_of_a_map_are_those_of_what_the_column_holds(tmp_path):
    xml = """<mujoco><worldbody><body><freejoint name="root"/><geom size="0.1"/>
    <body><joint name="slide" type="slide"/><geom size="0.1"/></body></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    np.savez(
        tmp_path / "run.npz", time=0.01 * np.arange(20), x=np.arange(20.0), v=60 * np.ones(20), w=np.ones(20)
    )
    columns = {"qpos:root:0": {"from": "x", "unit": "mm"}, "qpos:slide": {"from": "x", "unit": "cm"}}
    columns |= {"qvel:root:1": {"from": "v", "unit": "cm/s"}, "qvel:root:4": {"from": "v", "unit": "rpm"}}
    columns |= {f"qpos:root:{i}": {"from": "w", "scale": float(i == 3)} for i in (3, 4, 5, 6)}
    r = read_recording(tmp_path / "run.npz", model, names_of(model), columns)
    assert r.qpos[3, 0] == pytest.approx(0.003) and r.qpos[3, 7] == pytest.approx(0.03)
    assert r.qvel[0, 1] == pytest.approx(0.6) and r.qvel[0, 4] == pytest.approx(2 * np.pi)


def test_logs_in_formats_that_are_not_read_are_told(tmp_path, arm):
    (tmp_path / "robot.mat").write_bytes(b"")
    with pytest.raises(InputError, match=r"holds no \.npz or \.csv file \(but robot\.mat\)"):
        load_recordings([tmp_path], *arm)
    (tmp_path / "robot.mat").rename(tmp_path / "robot.mcap")
    np.savez(tmp_path / "run.npz", time=0.01 * np.arange(20), qpos=np.zeros((20, 2)), ctrl=np.zeros((20, 2)))
    (found,) = load_recordings([tmp_path], *arm)
    assert "robot.mcap: not read" in found.warnings[0]
    # also where a bag's own folder holds them
    (tmp_path / "metadata.yaml").write_text("")
    assert [r.name for r in load_recordings([tmp_path], *arm)] == ["run"]
