"""Names of a log for those of a model, commands for what is told by them, and clocks."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.machine.model import names_of
from mpge_jax.diagnosis.recordings.formats.tables import Column, Log, Table
from mpge_jax.diagnosis.recordings.joining import join, quantity_of
from mpge_jax.diagnosis.recordings.joint_names import match, numbered
from mpge_jax.diagnosis.recordings.rows.rows_in_time import (
    Clock,
    held,
    interpolated,
    middles,
    without_empty_rows,
)
from tests.diagnosis.machines import ARM

UR = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint"]


@pytest.mark.parametrize(
    ("found", "wanted", "pairs"),
    [
        (UR, ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2"], {i: i for i in range(5)}),
        (["fer_joint2", "fer_joint1"], ["joint1", "joint2"], {0: 1, 1: 0}),
        (["panda_joint1", "panda_finger_joint1"], ["joint1"], {0: 0}),
        (["elbow"], ["elbow_flex"], {0: 0}),
        (["ElbowFlex.pos", "WristRoll.pos"], ["wrist_roll", "elbow_flex"], {0: 1, 1: 0}),
        # of two that fit equally well neither is taken
        (["left_knee", "right_knee"], ["knee"], {}),
        (["left_knee", "knee", "right_knee"], ["knee"], {1: 0}),
        (["left_knee", "right_knee", "spare_left_knee"], ["knee"], {}),
        (["joint11"], ["joint1"], {}),
        (["a", "a"], ["a"], {}),
        (["hand_x"], ["elbow"], {}),
        ([""], [""], {0: 0}),
    ],
)
def test_names_match_by_their_words(found, wanted, pairs):
    assert match(found, wanted) == pairs


def test_names_that_only_count():
    assert numbered(["motor_0", "motor_1"]) and numbered(["joint1.pos", "joint2.pos", "joint3.pos"])
    assert not numbered(["motor_1", "motor_0"]) and not numbered(["left_1", "right_2"])
    assert not numbered(["x", "y"])


SERVOS = """<mujoco><worldbody><body><joint name="a" type="slide"/><geom size=".1"/>
<body><joint name="b" type="slide"/><geom size=".1"/></body></body></worldbody>
<actuator><motor name="m" joint="a" gear="4"/><position name="p" joint="b" kp="5"/><velocity name="v" joint="b" kv="2"/>
<intvelocity name="i" joint="b" kp="5" actrange="-1 1"/><general name="g" joint="b" gaintype="fixed" biastype="affine"
biasprm="1 0 0"/></actuator></mujoco>"""


def test_what_actuators_are_told():
    model = mujoco.MjModel.from_xml_string(SERVOS)
    assert [quantity_of(model, a) for a in range(model.nu)] == [
        "effort",
        "position",
        "velocity",
        "velocity",
        None,
    ]


def _arm():
    model = mujoco.MjModel.from_xml_string(ARM)
    return model, names_of(model)


def _table(title, time, clock="header stamps", received=None, **columns):
    parts = ("shoulder", "elbow")
    made = tuple(
        Column(f"{title}/{key}", np.asarray(v, float), parts, *_means(key)) for key, v in columns.items()
    )
    return Table(title, made, np.asarray(time, float), clock, received)


def _means(key):
    return {"position": ("qpos", None), "velocity": ("qvel", None), "torque": ("ctrl", "effort")}.get(
        key, ("ctrl", "position")
    )


T = 0.1 * np.arange(6)
Q = np.stack([np.sin(T), np.cos(T)], 1)


def test_a_command_is_taken_from_the_quantity_that_its_actuator_is_told():
    """The shoulder is a motor and the elbow a servo."""
    torque, target = np.full((6, 2), 3.0), np.full((6, 2), 0.5)
    log = Log("run", (_table("/s", T, position=Q), _table("/c", T, torque=torque, target=target)))
    out = join(log, *_arm())
    np.testing.assert_array_equal(out.data["ctrl"], [[3.0, 0.5]] * 6)
    found = {key: (column.title, column.parts[i]) for key, (column, i) in out.found.items() if "ctrl" in key}
    assert found == {
        "ctrl:shoulder_motor": ("/c/torque", "shoulder"),
        "ctrl:elbow_servo": ("/c/target", "elbow"),
    }
    only = join(Log("run", (_table("/s", T, position=Q), _table("/c", T, target=target))), *_arm())
    assert "ctrl" not in only.data
    assert any("commands of position, but the model's actuators are told an effort" in n for n in only.notes)
    # commands of one actuator alone are no commands
    assert not [target for target in only.found if target.startswith("ctrl")] and not only.apart


def test_commands_are_held_until_the_next_one():
    sent = np.array([0.05, 0.2, 0.31])
    np.testing.assert_array_equal(held(T, sent, np.array([1.0, 2.0, 3.0])), [np.nan, 1, 2, 2, 3, 3])
    np.testing.assert_array_equal(held(T, sent, np.array([1.0, np.nan, 3.0])), [np.nan, 1, 1, 1, 3, 3])
    assert np.isnan(held(T, np.zeros(0), np.zeros(0))).all()


def test_two_clocks_are_brought_together_by_the_least_delay():
    """Commands carry the recorder's stamps only, which is 5 s ahead of the robot's; states are 1 to 3 ms under way."""
    received = T + 5.0 + np.array([0.003, 0.001, 0.002, 0.003, 0.001, 0.002])
    states = _table("/s", T, received=received, position=Q)
    sent = Table("/c", (), T + 5.0, "receive stamps", T + 5.0)
    clock = Clock.of(states, sent)
    assert clock.ahead == pytest.approx(5.001)
    assert clock.told == (
        "/c comes apart from /s, by receive stamps beside header stamps, between which lay 5001 ms at least: taken off"
    )
    same = Clock.of(states, Table("/c", (), T, "header stamps", received))
    assert same.ahead == 0.0 and same.told == "/c comes apart from /s"
    # the other way round
    back = Clock.of(Table("/s", (), T + 5.0, "receive stamps", T + 5.0), _table("/c", T, received=received))
    assert back.ahead == pytest.approx(-5.001)


def test_commands_are_read_on_the_clock_of_the_states():
    states = _table("/s", T, received=T + 5.0, position=Q)
    ctrl = np.arange(12.0).reshape(6, 2)
    commands = Table("/c", (Column("/c/data", ctrl, None, "ctrl"),), T + 5.0, "receive stamps", T + 5.0)
    np.testing.assert_array_equal(join(Log("run", (states, commands)), *_arm()).data["ctrl"], ctrl)


def test_other_tables_are_interpolated_where_they_reach():
    found = interpolated(T, np.array([0.05, 0.25]), np.array([1.0, 3.0]))
    np.testing.assert_allclose(found, [np.nan, 1.5, 2.5, np.nan, np.nan, np.nan])


def test_a_row_holds_what_was_sent_by_the_middle_of_its_time():
    np.testing.assert_allclose(middles(np.array([0.0, 0.1, 0.4])), [0.05, 0.25, 0.5])
    sent = Table("/c", (Column("/c", np.arange(6.0)[:, None], means="ctrl"),), T + 0.04, "header stamps")
    out = join(Log("run", (_table("/s", T, position=Q),)), *_arm())
    np.testing.assert_array_equal(out.at_rows(sent, np.arange(6.0), "ctrl"), np.arange(6.0))
    out.lag = 0.02
    np.testing.assert_array_equal(out.at_rows(sent, np.arange(6.0), "ctrl"), [np.nan, 0, 1, 2, 3, 4])
    assert list(out.apart) == ["/c"]


def test_rows_without_a_reading_are_left_out():
    q = np.arange(8.0)[:, None] * np.ones((1, 2))
    q[4] = q[3]
    ctrl = np.zeros((8, 1))
    ctrl[0] = np.nan
    data = {"time": np.array([0, 1, 2, 3, 4, 5, 5, 6.0]), "qpos": q, "ctrl": ctrl}
    kept, notes = without_empty_rows("run", data)
    np.testing.assert_array_equal(kept["time"], [1, 2, 3, 5, 6])
    assert len(notes) == 3 and "read from 1 s to 6 s" in notes[0]
    assert "1 rows repeat the stamp" in notes[1] and "1 rows repeat the reading" in notes[2]
    # a machine at rest says the same again and again
    resting = {"time": np.arange(8.0), "qpos": np.repeat([[0.0], [1.0]], 4, axis=0)}
    kept, notes = without_empty_rows("run", resting)
    assert kept["time"].size == 8 and notes == []


def test_forces_at_joints_are_those_of_actuators_by_their_gear():
    model = mujoco.MjModel.from_xml_string(SERVOS.replace('<general name="g"', '<general name="g" gear="1"'))
    columns = (
        Column("/s/position", np.stack([T, T], 1), ("a", "b"), "qpos"),
        Column("/s/effort", np.stack([8 + T, T], 1), ("a", "b"), "actuator_force"),
    )
    out = join(Log("run", (Table("/s", columns, T, "header stamps"),)), model, names_of(model))
    np.testing.assert_allclose(out.data["actuator_force"][:, 0], (8 + T) / 4)
    of_actuators = Column("actuator_force", np.stack([8 + T, T, T, T, T], 1), None, "actuator_force")
    own = join(Log("run", (Table("", (columns[0], of_actuators), T, ""),)), model, names_of(model))
    np.testing.assert_allclose(own.data["actuator_force"][:, 0], 8 + T)
    # which of four actuators pushed, nobody knows
    assert np.isnan(out.data["actuator_force"][:, 1:]).all()


def test_nothing_that_is_known_is_told_with_what_there_is():
    table = Table("/s", (Column("/s/x", np.zeros((6, 3))),), T, "header stamps")
    with pytest.raises(
        InputError, match=r"positions of shoulder, elbow; it has /s/x \[3\] \(not read: /img\)"
    ):
        join(Log("run", (table,), unread=("/img",)), *_arm())
    with pytest.raises(InputError, match="no numbers that can be read"):
        join(Log("run", ()), *_arm())
