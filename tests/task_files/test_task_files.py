"""Task files: names that a model or a file brings along stay names."""

import ast

import pytest

from mpge_jax.task_files.robot import name_of, robot_of
from mpge_jax.task_files.template import corrected_text_of, text_of

EVIL = '\n__import__("os").abort()\n# """ \\'
ARM = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size=".1"/></body></worldbody>
<actuator><motor joint="a"/></actuator><keyframe><key name="KEY" qpos="0.2"/></keyframe></mujoco>"""


def calls(text: str) -> set[str]:
    return {ast.unparse(n.func) for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Call)}


@pytest.mark.parametrize("write", [text_of, corrected_text_of])
def test_names_of_models_files_and_poses_are_never_run(tmp_path, write):
    texts = []
    for folder, key in (("plain", "rest"), ('od"d', EVIL)):
        (tmp_path / folder).mkdir()
        path = tmp_path / folder / "m.xml"
        path.write_text(ARM.replace("KEY", key.replace('"', "&quot;").replace("\n", "&#10;")))
        robot = robot_of(path, tmp_path / "task.py")
        assert key.strip()[:4] in robot.pose
        texts.append(write(robot))
    plain, odd = texts
    assert "abort" in odd and calls(odd) == calls(plain)
    assert repr('od"d/m.xml') in {
        ast.unparse(n) for n in ast.walk(ast.parse(odd)) if isinstance(n, ast.Constant)
    }


@pytest.mark.parametrize("write", [text_of, corrected_text_of])
def test_where_episodes_start_is_told_as_it_is(tmp_path, write):
    path = tmp_path / "m.xml"
    path.write_text(ARM.replace('<keyframe><key name="KEY" qpos="0.2"/></keyframe>', ""))
    assert "# Where episodes start: the reference pose.\n" in write(robot_of(path, tmp_path / "task.py"))


def test_a_name_is_a_name(tmp_path):
    (tmp_path / "m.xml").write_text(ARM)
    with pytest.raises(ValueError, match="letters, digits"):
        robot_of(tmp_path / "m.xml", tmp_path / "t.py", 'x"\n')
    assert [name_of(x) for x in ("my_robot", "3 legs!", "--")] == ["MyRobot", "Robot3Legs", "Robot"]
