"""What is said of a log before it is diagnosed, the picture, and the map to start from."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
from matplotlib.image import imread

from experiments.inspect import main
from mpge_jax.diagnosis.inspection.doubts import meaning, ratio
from mpge_jax.diagnosis.inspection.map_file import map_text
from mpge_jax.diagnosis.inspection.overview import overviews
from mpge_jax.diagnosis.inspection.picture import POINTS, _thinned, draw
from mpge_jax.diagnosis.inspection.summary import summary
from mpge_jax.diagnosis.machine.model import names_of
from mpge_jax.diagnosis.recordings.column_map import load
from mpge_jax.diagnosis.recordings.reader import load_recordings
from tests.diagnosis.machines import ARM, PENDULUM
from tests.diagnosis.recordings.formats.logs import arm_messages, motion, store, write_lerobot, write_ros2


def _model(xml=ARM):
    model = mujoco.MjModel.from_xml_string(xml)
    return model, names_of(model)


def _csv(path: Path) -> Path:
    m = motion()
    columns = {"timestamp": m["time"], "note": m["time"] * np.nan}
    columns |= {f"action[{i}]": m["ctrl"][:, i] for i in (0, 1)}
    columns |= {f"observation.state.{j}": m["qpos"][:, i] for i, j in ((1, "elbow"), (0, "shoulder"))}
    np.savetxt(
        path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments=""
    )
    return path


def _npz(path: Path, **changes) -> Path:
    m = motion()
    data = {
        "time": m["time"],
        "qpos": m["qpos"],
        "qvel": m["qvel"],
        "ctrl": m["ctrl"],
        "actuator_force": m["force"],
    }
    np.savez(path, **{**data, **changes})
    return path


LOGS = {
    "ros2": lambda folder: write_ros2(folder / "run", arm_messages(store()), store()),
    "lerobot": lambda folder: write_lerobot(folder / "set", 3, ["elbow.pos", "shoulder.pos"]),
    "csv": lambda folder: _csv(folder / "run.csv"),
    "npz": lambda folder: _npz(folder / "run.npz"),
}


@pytest.mark.parametrize("kind", LOGS)
def test_the_map_reads_the_log_as_it_is_read_without(tmp_path, kind):
    """Every line that was recognised is in it, with names and numbers that lead to the same columns."""
    path, arm = LOGS[kind](tmp_path), _model()
    (first, *_) = overviews(path, *arm)
    (tmp_path / "map.yaml").write_text(map_text(first, *arm))
    columns = load(tmp_path / "map.yaml")
    assert {"qpos:shoulder", "qpos:elbow", "ctrl:shoulder_motor", "ctrl:elbow_servo"} <= set(columns)
    for a, b in zip(load_recordings([path], *arm), load_recordings([path], *arm, columns), strict=True):
        for key in ("time", "qpos", "ctrl"):
            np.testing.assert_array_equal(getattr(a, key), getattr(b, key))
        np.testing.assert_array_equal(a.known("qvel"), b.known("qvel"))
        np.testing.assert_array_equal(a.known("force"), b.known("force"))


def test_a_map_of_nothing_is_a_map_of_comments(tmp_path):
    np.savez(tmp_path / "run.npz", x=np.zeros((20, 3)))
    (o,) = overviews(tmp_path / "run.npz", *_model())
    (tmp_path / "map.yaml").write_text(map_text(o, *_model()))
    assert load(tmp_path / "map.yaml") == {}
    assert o.problem is not None and "there is no 'time'" in o.problem
    text = summary(o, _model()[1])
    assert "positions: none" in text and "cannot be diagnosed as it is: run.npz: there is no 'time'" in text


def test_what_a_map_names_is_shown_as_found(tmp_path):
    """A log that nothing is recognised in, in degrees and milliseconds."""
    m = motion()
    columns = {"t_ms": 1e3 * m["time"], "a": np.degrees(m["qpos"][:, 0]), "b": np.degrees(m["qpos"][:, 1])}
    columns |= {"u": m["ctrl"][:, 0], "w": m["ctrl"][:, 1]}
    path = tmp_path / "run.csv"
    np.savetxt(
        path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments=""
    )
    given = {"time": {"from": "t_ms", "unit": "ms"}, "qpos:shoulder": {"from": "a", "unit": "deg"}}
    given |= {"qpos:elbow": {"from": "b", "unit": "deg"}, "ctrl:shoulder_motor": "u", "ctrl:elbow_servo": "w"}
    (o,) = overviews(path, *_model(), given)
    text = summary(o, _model()[1])
    assert "60 rows in 0.59 s, 100 a second by the map's times, steps of 10 ms" in text
    read_as = {line.split()[0]: line.split()[-1] for line in text.splitlines() if line.startswith("  ")}
    assert [read_as[c] for c in columns] == [*given]
    # of velocities and forces the log has none
    assert "not found:\n  velocities: none\n  forces: none\n" in text
    (tmp_path / "map.yaml").write_text(map_text(o, *_model()))
    assert load(tmp_path / "map.yaml") == given | {
        f"ctrl:{a}": {"from": given[f"ctrl:{a}"]} for a in _model()[1].actuators
    }
    # a part of an array, by its number
    (o,) = overviews(_npz(tmp_path / "run.npz"), *_model(), {"qpos:elbow": {"from": "ctrl", "column": 1}})
    column, part = o.found["qpos:elbow"]
    assert column.title == "ctrl" and part == 1


def test_clocks_are_told(tmp_path):
    (o,) = overviews(LOGS["ros2"](tmp_path), *_model())
    text = summary(o, _model()[1])
    assert "/joint_states: 60 rows in 0.59 s, 100 a second by header stamps, steps of 10 ms, no gaps" in text
    assert "/arm/commands: 60 rows" in text and "by receive stamps" in text
    assert (
        "/arm/commands comes apart" in text
        and "may be the clock's" in text
        and "It can be diagnosed: 60 rows" in text
    )
    (o, _) = overviews(LOGS["lerobot"](tmp_path), *_model())
    text = summary(o, _model()[1])
    assert "50 a second by frame_index / fps, even by definition" in text
    assert "made up by the recorder" in text and "jitter" not in text
    m = motion()
    late = m["time"] + 0.5 * (np.arange(60) > 30)
    (o,) = overviews(_npz(tmp_path / "gap.npz", time=late), *_model())
    assert "1 gaps" in summary(o, _model()[1])


def _doubts(folder, xml=ARM, **changes):
    (o,) = overviews(_npz(folder / "run.npz", **changes), *_model(xml))
    return "; ".join(o.doubts)


def test_units_that_look_wrong(tmp_path):
    m = motion()
    limited = ARM.replace('name="shoulder"', 'name="shoulder" limited="true" range="-90 90"')
    assert _doubts(tmp_path) == _doubts(tmp_path, limited) == ""
    degrees = np.rad2deg(m["qpos"])
    said = _doubts(tmp_path, limited, qpos=degrees)
    assert "positions of shoulder reach 57.3 beside its range of -1.57 to 1.57 rad: degrees" in said
    assert "velocities of shoulder are 0.0175 times as large (degrees for radians?)" in said
    assert "velocities of shoulder are of opposite sign" in _doubts(tmp_path, qvel=-m["qvel"])
    assert "57.4 times as large" in _doubts(tmp_path, qvel=np.rad2deg(m["qvel"]))
    assert "leave its range" in _doubts(tmp_path, limited, qpos=m["qpos"] + 1.2)
    assert "times of the log are 10 apart: milliseconds" in _doubts(tmp_path, time=1e3 * m["time"])
    assert "nanoseconds" in _doubts(tmp_path, time=1e9 * m["time"])
    assert "force of shoulder_motor is always 0" in _doubts(tmp_path, actuator_force=np.zeros((60, 2)))
    assert "command of elbow_servo never changes" in _doubts(tmp_path, ctrl=m["ctrl"] * [1, 0])
    target = np.stack([m["ctrl"][:, 0], np.rad2deg(m["qpos"][:, 1])], 1)
    assert "commands of elbow_servo are 57.3 times as large" in _doubts(tmp_path, ctrl=target)
    small = ARM.replace('joint="shoulder"/>', 'joint="shoulder" ctrlrange="-.1 .1" forcerange="-.1 .1"/>')
    said = _doubts(tmp_path, small)
    assert "leave its ctrlrange of -0.1 to 0.1" in said and "reaches 0.59, its forcerange 0.1" in said


def test_a_motor_that_could_not_turn_a_joint_so_far_tells_degrees(tmp_path):
    model, t = _model(PENDULUM), np.arange(300) / 100
    swing = np.stack([np.sin(2 * np.pi * t)], 1)
    turning = 2 * np.pi * np.stack([np.cos(2 * np.pi * t)], 1)
    torque = 0.1 * swing

    def said(scale):
        path = tmp_path / "run.npz"
        np.savez(path, time=t, qpos=scale * swing, qvel=scale * turning, ctrl=torque)
        (o,) = overviews(path, *model)
        return o, "; ".join(o.doubts)

    assert "radians" not in said(1.0)[1]
    o, doubts = said(180 / np.pi)
    assert "positions of hinge reach 57.3, and cannot be radians" in doubts
    assert "velocities of hinge are degrees a second if those are degrees" in doubts
    assert '"qpos:hinge": {from: "qpos", unit: deg}' in map_text(o, *model)


def test_titles_with_units_are_read_and_the_map_names_these(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(
        "time [ms],shoulder_pos [deg],elbow_pos [deg],shoulder_cmd,elbow_cmd\n"
        + "".join(f"{10 * k},{k},{2 * k},0,{k % 7}\n" for k in range(30))
    )
    (o,) = overviews(path, *_model())
    assert o.recording is not None
    assert o.recording.qpos[-1] == pytest.approx(np.deg2rad([29, 58]))
    text = map_text(o, *_model())
    assert '"qpos:elbow": {from: "elbow_pos [deg]", unit: "deg"}' in text
    (tmp_path / "map.yaml").write_text(text)
    (again,) = load_recordings([path], *_model(), load(tmp_path / "map.yaml"))
    np.testing.assert_allclose(again.qpos, o.recording.qpos)
    np.testing.assert_allclose(again.time, o.recording.time)


def test_ratios_are_only_told_of_what_goes_together():
    t = np.linspace(0, 6, 200)
    assert ratio(3 * np.sin(t), np.sin(t)) == pytest.approx(3.0)
    assert ratio(np.cos(t), np.sin(t)) is None
    assert ratio(t[:5], t[:5]) is None and ratio(0 * t, t) is None
    assert meaning(1.05) is None and meaning(3.0) is None
    assert "degrees" in meaning(57.0) and "sign" in meaning(-1.0) and meaning(1e3) is None
    assert "millimetres" in meaning(1e-3, slides=True) and meaning(57.0, slides=True) is None


@pytest.mark.parametrize("recorded", ["degrees", "positions in degrees", "velocities in degrees"])
def test_the_map_puts_doubted_units_right(tmp_path, capsys, recorded):
    """The command names the map, and what the map reads is the motion in SI units."""
    m, model, log = motion(), tmp_path / "arm.xml", tmp_path / "run.npz"
    model.write_text(ARM.replace('name="shoulder"', 'name="shoulder" limited="true" range="-90 90"'))
    turned = np.array([180 / np.pi, 1.0])
    _npz(
        log,
        qpos=m["qpos"] * (1.0 if recorded == "velocities in degrees" else turned),
        qvel=m["qvel"] * (1.0 if recorded == "positions in degrees" else turned),
    )
    seen = tmp_path / "seen"
    assert main([str(log), "--model", str(model), "--out", str(seen)]) == 0
    said = capsys.readouterr().out
    assert (
        f"units in the map: python -m experiments.diagnose --model {model} --recordings {log} --map {seen}"
        in said
    )
    lines = [
        line for line in (seen / "map.yaml").read_text().splitlines() if "unit: " in line and "  # " in line
    ]
    assert len(lines) == (2 if recorded == "degrees" else 1) and all("shoulder" in line for line in lines)
    (read,) = load_recordings([log], *_model(), load(seen / "map.yaml"))
    np.testing.assert_allclose(read.qpos, m["qpos"], atol=1e-12)
    np.testing.assert_allclose(read.qvel, m["qvel"], atol=1e-12)
    assert main([str(log), "--model", str(model), "--out", str(seen), "--map", str(seen / "map.yaml")]) == 0
    assert "looks wrong" not in capsys.readouterr().out


def test_times_in_milliseconds_are_one_doubt_and_the_map_converts_them(tmp_path, capsys):
    m, model, log, seen = motion(), tmp_path / "arm.xml", tmp_path / "run.npz", tmp_path / "seen"
    model.write_text(ARM)
    _npz(log, time=1e3 * m["time"])
    for k in range(3):
        shutil.copy(log, tmp_path / f"again_{k}.npz")
    logs = [str(log), *map(str, sorted(tmp_path.glob("again_*.npz")))]
    assert main([*logs, "--model", str(model), "--out", str(seen)]) == 1
    said = capsys.readouterr().out
    assert "velocities of" not in said and ").;" not in said
    (read,) = load_recordings([log], *_model(), load(seen / "map.yaml"))
    np.testing.assert_allclose(read.time, m["time"])


def test_no_map_is_offered_where_nothing_is_left_to_map(tmp_path, capsys):
    m, model, log = motion(), tmp_path / "arm.xml", tmp_path / "run.npz"
    model.write_text(ARM)
    np.savez(log, time=m["time"], qpos=m["qpos"])
    arguments = [str(log), "--model", str(model), "--out", str(tmp_path / "seen")]
    assert main(arguments) == 1
    said = capsys.readouterr().out
    assert "to diagnose" not in said and "record at least one of them" in said
    np.savez(log, time=m["time"], qpos=m["qpos"], ctrl=np.c_[m["ctrl"], m["ctrl"]])
    assert main(arguments) == 1
    assert "to diagnose, once a map says what is missing: " in capsys.readouterr().out


def test_the_picture_shows_every_column(tmp_path):
    (o,) = overviews(_npz(tmp_path / "run.npz", spare=np.zeros((60, 3)), wide=np.zeros((60, 40))), *_model())
    path = draw(o, tmp_path / "columns.png")
    # 4 x 2 numbers that are read and 3 that are not, one panel for the 40: 12 panels in rows of 4
    assert imread(path).shape[:2] == (570, 1600)


def test_spikes_stay_in_a_thinned_line():
    value = np.zeros(100_000)
    value[54_321], value[77_777] = 5.0, -3.0
    time, thin = _thinned(np.arange(100_000.0), value)
    assert thin.size <= 2 * POINTS and thin.max() == 5.0 and thin.min() == -3.0
    assert time[thin.argmax()] == 54_321.0 and (np.diff(time) >= 0).all()


def test_the_command_from_a_bag_to_a_diagnosis(tmp_path, capsys):
    bag = write_ros2(tmp_path / "my run", arm_messages(store()), store())
    (tmp_path / "arm.xml").write_text(ARM)
    arguments = [str(bag), "--model", str(tmp_path / "arm.xml"), "--out", str(tmp_path / "seen")]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert sorted(p.name for p in (tmp_path / "seen").iterdir()) == ["columns.png", "map.yaml"]
    command = shlex.split(said.split("to diagnose: ")[1])
    assert command[:3] == ["python", "-m", "experiments.diagnose"] and str(bag) in command
    assert main([*arguments, "--map", str(tmp_path / "seen" / "map.yaml")]) == 0
    assert "--map" in capsys.readouterr().out.split("to diagnose: ")[1]


def test_what_the_command_cannot_read_is_one_sentence(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "bad.mcap").write_bytes(b"no")
    for arguments in (
        [str(tmp_path / "bad.mcap")],
        [str(tmp_path / "none.bag")],
        [str(tmp_path / "arm.xml")],
    ):
        assert main([*arguments, "--model", str(tmp_path / "arm.xml"), "--out", str(tmp_path / "out")]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    (tmp_path / "file").write_text("")
    run = _npz(tmp_path / "run.npz")
    assert main([str(run), "--model", str(tmp_path / "arm.xml"), "--out", str(tmp_path / "file")]) == 2
    np.savez(run, x=np.zeros(9))
    capsys.readouterr()
    assert main([str(run), "--model", str(tmp_path / "arm.xml"), "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().out
    assert "to diagnose, once a map says what is missing: " in said
    assert f"--map {tmp_path / 'out' / 'map.yaml'} --out out" in said
    for k in range(5):
        np.savez(tmp_path / f"run_{k}.npz", time=np.arange(9.0), qpos=np.zeros((9, 7)))
    logs = sorted(map(str, tmp_path.glob("run_*.npz")))
    assert main([*logs, "--model", str(tmp_path / "arm.xml"), "--out", str(tmp_path / "out")]) == 1
    assert "\nrun_4: 'qpos' has 7 columns" in capsys.readouterr().out


def test_many_episodes_are_told_in_short(tmp_path, capsys):
    folder = write_lerobot(tmp_path / "set", 3, ["shoulder.pos", "elbow.pos"], episodes=6)
    (tmp_path / "arm.xml").write_text(ARM)
    assert main([str(folder), "--model", str(tmp_path / "arm.xml"), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert said.count("It can be diagnosed") == 3 and said.count("as those above") == 3
