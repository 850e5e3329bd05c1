"""The robot's picture: rendered by MuJoCo in a process of its own, and drawn as a tree where that fails."""

import itertools
import os
import sys
from types import SimpleNamespace

import matplotlib.image
import mujoco
import numpy as np
import pytest

from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.machine.model import compile_variable, names_of
from mpge_jax.diagnosis.report.figures import every_figure, robot_picture, robot_render
from mpge_jax.diagnosis.report.figures.marks import Mark, find
from tests.diagnosis.machines import ARM, BOX, PENDULUM

NOTHING = np.zeros((0, 3))
ROTORS = """<mujoco><worldbody><body name="drone"><freejoint name="root"/><geom type="box" size=".2 .05 .02"/>
<site name="left" pos="-.2 0 0"/></body></worldbody>
<actuator><motor name="rotor" site="left" gear="0 0 2 0 0 0"/></actuator></mujoco>"""


def _posed(xml):
    model = compile_variable(mujoco.MjSpec.from_string(xml))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def _is_red(pixels):
    r, g, b = (pixels[..., i].astype(int) for i in range(3))
    return (r > 90) & (r > 2.5 * g) & (r > 2.5 * b)


def _rendered(*arguments):
    picture = robot_render.render(*arguments)
    if picture is None:
        pytest.skip("MuJoCo cannot render offscreen here: the rendered picture was not looked at")
    return picture


def test_a_marked_joint_is_where_its_axis_is_drawn():
    # the elbow's anchor is 0.3 m below the shoulder's
    points, axes = np.array([[0.0, 0.0, -0.3]]), np.array([[0.0, 1.0, 0.0]])
    spec = mujoco.MjSpec.from_string(ARM)
    plain = _rendered(spec, np.zeros(2), points, 0 * axes, [], [])
    marked = _rendered(spec, np.zeros(2), points, axes, [], [])
    assert not _is_red(plain.pixels).any()
    rows, columns = np.nonzero(_is_red(marked.pixels))
    x, y = marked.points[0]
    assert 0.2 * robot_render.WIDTH < x < 0.8 * robot_render.WIDTH
    # the rod goes both ways from the anchor; the link hides part of it
    assert abs(columns.min() - x) < 90 and abs(columns.max() - x) < 90
    assert rows.min() <= y <= rows.max() and columns.min() <= x <= columns.max()


def test_a_marked_body_is_painted_and_the_machine_fills_the_picture():
    spec = mujoco.MjSpec.from_string(ARM)
    picture = _rendered(spec, np.zeros(2), NOTHING, NOTHING, [2], [])
    red = _is_red(picture.pixels)
    assert 0.002 < red.mean() < 0.2
    # the forearm is the lower link
    drawn = (picture.pixels < 240).any(-1)
    rows = np.nonzero(drawn.any(1))[0]
    assert np.nonzero(red)[0].mean() > rows.mean()
    assert np.ptp(rows) > 0.5 * robot_render.HEIGHT
    assert (picture.pixels[0, 0] == 255).all()


def test_a_far_wall_does_not_make_the_machine_small():
    wall = '<worldbody><geom type="box" size="3 .1 3" pos="0 9 0" contype="0" conaffinity="0"/>'
    spec = mujoco.MjSpec.from_string(PENDULUM.replace("<worldbody>", wall))
    picture = _rendered(spec, np.zeros(1), NOTHING, NOTHING, [1], [])
    assert np.ptp(np.nonzero(_is_red(picture.pixels))[0]) > 0.5 * robot_render.HEIGHT


def test_only_the_child_is_told_the_backend(monkeypatch):
    seen = []

    def run(_command, env, **_kwargs):
        seen.append(env.get("MUJOCO_GL"))
        return SimpleNamespace(returncode=1)

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(robot_render.subprocess, "run", run)
    monkeypatch.setattr(sys, "platform", "linux")
    assert (
        robot_render.render(mujoco.MjSpec.from_string(PENDULUM), np.zeros(1), NOTHING, NOTHING, [], [])
        is None
    )
    assert seen == ["egl", "osmesa"] and "MUJOCO_GL" not in os.environ
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    assert robot_render.backends() == ("glfw",)
    monkeypatch.setenv("MUJOCO_GL", "disable")
    assert robot_render.backends() == ()


FAILURES = {
    "crashes": "import os; os.abort()",
    "hangs": "import time; time.sleep(60)",
    "writes no picture": "pass",
    "writes rubbish": "import sys; open(sys.argv[1] + '/picture.npz', 'wb').write(b'PK rubbish')",
    "draws nothing": "import sys; import numpy as np; np.savez(sys.argv[1] + '/picture.npz', "
    "pixels=np.zeros((9, 9, 3), 'u1'), points=np.zeros((1, 2)))",
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_tree_is_drawn_where_rendering_fails(failure, tmp_path, monkeypatch):
    script = tmp_path / "child.py"
    script.write_text(FAILURES[failure])
    monkeypatch.setattr(robot_render.render_process, "__file__", str(script))
    monkeypatch.setattr(robot_render, "backends", lambda: ("egl",))
    monkeypatch.setattr(robot_render, "TIME_LIMIT", 2.0 if failure == "hangs" else 60.0)
    monkeypatch.setattr(robot_render, "_hung", set())
    trees = []
    tree = robot_picture._tree
    monkeypatch.setattr(robot_picture, "_tree", lambda *a: trees.append(1) or tree(*a))
    spec = mujoco.MjSpec.from_string(ARM)
    marks = [Mark("joint", 1, "elbow\ncoulomb friction"), Mark("world", 0, "mass scale")]
    path = robot_picture.robot(spec, compile_variable(spec), np.zeros((1, 2)), marks, tmp_path / "robot.png")
    # nobody waits twice for a driver that hangs
    assert robot_render._hung == ({"egl"} if failure == "hangs" else set())
    if failure == "hangs":
        monkeypatch.setattr(robot_render.subprocess, "run", lambda *_, **__: pytest.fail("tried again"))
        assert robot_render.render(spec, np.zeros(2), NOTHING, NOTHING, [], []) is None
    assert trees and _is_red((255 * matplotlib.image.imread(path)[..., :3]).astype("u1")).any()


def test_a_machine_without_shapes_is_drawn_as_a_tree():
    inertial = '<inertial pos="0 0 -.1" mass="1" diaginertia=".1 .1 .1"/>'
    xml = f"<mujoco><worldbody><body><joint/>{inertial}</body></worldbody></mujoco>"
    assert robot_render.render(mujoco.MjSpec.from_string(xml), np.zeros(1), NOTHING, NOTHING, [], []) is None


def test_marks_are_found_for_every_kind_of_place():
    model, data = _posed(ARM)
    elbow = find(model, data, Mark("joint", 1, ""))
    np.testing.assert_allclose(elbow.point, [0, 0, -0.3], atol=1e-12)
    np.testing.assert_allclose(elbow.along, [0, 1, 0], atol=1e-12)
    servo = find(model, data, Mark("actuator", 1, ""))
    np.testing.assert_allclose(servo.point, elbow.point)
    fore = find(model, data, Mark("body", 2, ""))
    np.testing.assert_allclose(fore.point, [0, 0, -0.425], atol=1e-12)
    assert fore.bodies == (2,)
    assert find(model, data, Mark("world", 0, "")) is None
    model, data = _posed(BOX)
    assert find(model, data, Mark("geom", 1, "")).geoms == (1,)
    model, data = _posed(ROTORS)
    rotor = find(model, data, Mark("actuator", 0, ""))
    np.testing.assert_allclose(rotor.point, [-0.2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(rotor.along, [0, 0, 1], atol=1e-12)
    assert not find(model, data, Mark("joint", 0, "")).along.any()


def _fit(*terms):
    return Fitted(Hypothesis.of(*terms), np.zeros(0), np.zeros(0))


def test_every_place_that_is_named_is_marked():
    names = names_of(_posed(ARM)[0])
    elbow = Term("coulomb_friction", Place("joint", "elbow", 1))
    other = Term("viscous_damping", Place("joint", "shoulder", 0))
    drive = Term("actuator_gain", Place("actuator", "shoulder_motor", 0))
    rival = SimpleNamespace(tied=True, term=other, fit=_fit(other))
    d = SimpleNamespace(
        terms=(elbow,),
        fit=_fit(elbow),
        rivals={elbow: [rival]},
        actuators=SimpleNamespace(fits=[_fit(drive)]),
        unexplained={"at": ["elbow_servo", "fore"]},
        prepared=SimpleNamespace(names=names),
    )
    assert every_figure.marks(d) == [
        Mark("joint", 1, "elbow\ncoulomb friction"),
        Mark("joint", 0, "shoulder\nor viscous damping"),
        Mark("actuator", 0, "shoulder_motor\nactuator gain"),
        Mark("actuator", 1, "elbow_servo\nunexplained"),
        Mark("body", 2, "fore\nunexplained"),
    ]


def test_names_with_dollar_signs_are_no_formulas(tmp_path, monkeypatch):
    monkeypatch.setattr(robot_picture, "render", lambda *_a: None)
    xml = PENDULUM.replace('"hinge"', r'"$\frac{$"')
    spec = mujoco.MjSpec.from_string(xml)
    place = Place("joint", r"$\frac{$", 0)
    term = Term("coulomb_friction", place)
    d = SimpleNamespace(terms=(term,), fit=_fit(term), rivals={}, actuators=None, unexplained=None)
    path = tmp_path / "robot.png"
    robot_picture.robot(spec, compile_variable(spec), np.zeros((1, 1)), every_figure.marks(d), path)
    assert path.stat().st_size > 1000


def test_labels_never_overlap():
    """Twelve labels at nearly one height, and two of which one would push the other out."""
    for wanted in ([(0.5 + 1e-3 * k, 3) for k in range(12)], [(0.97, 2), (0.99, 4)], [(0.1, 1)]):
        at, squeeze = robot_picture._stacked(wanted)
        sizes = [squeeze * 0.055 * (lines + 1) for _, lines in wanted]
        edges = [(y - 0.5 * h, y + 0.5 * h) for y, h in zip(at, sizes, strict=True)]
        assert edges[0][0] >= 0.0 and edges[-1][1] <= 1.0 + 1e-9
        assert all(a[1] <= b[0] + 1e-9 for a, b in itertools.pairwise(edges))


def test_many_labels_are_places_alone_and_few_say_what_is_there():
    def placed(count):
        marks = [Mark("joint", k, f"joint_{k}\ndry friction\ndamping") for k in range(count)]
        return robot_picture._placed(marks, np.array([[0.0, float(k)] for k in range(count)]), 0.0, 9.0)

    few, squeeze = placed(3)
    assert [text for _, text, _ in few] == [f"joint_{k}\ndry friction\ndamping" for k in range(3)]
    assert squeeze == 1.0
    many, squeeze = placed(8)
    assert [text for _, text, _ in many] == [f"joint_{k}" for k in range(8)] and squeeze == 1.0
    assert [point for point, _, _ in many] == [(0.0, float(k)) for k in range(8)]


def test_what_is_named_at_one_point_is_one_label():
    marks = [
        Mark("joint", 0, "wrist\ndry friction"),
        Mark("joint", 0, "wrist\ndamping"),
        Mark("joint", 1, "elbow"),
    ]
    labels = robot_picture._by_point(marks, np.array([[1.0, 5.0], [1.0, 5.0], [2.0, 3.0]]))
    assert labels == {(2.0, 3.0): ["elbow"], (1.0, 5.0): ["wrist", "dry friction", "damping"]}
