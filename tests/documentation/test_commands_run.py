"""Commands of the README and of the page of the diagnosis do what they say, on an arm with something concealed."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments import diagnose, inspect, new
from experiments.fleet import __main__ as fleet
from tests.diagnosis.machines import ARM, record
from tests.diagnosis.recordings.formats import logs
from tests.documentation.test_docs import commands

PAGES = ("README.md", "diagnosis.md")
MAINS = {"diagnose": diagnose.main, "inspect": inspect.main, "fleet": fleet.main, "new": new.main}
SECONDS = 5
"""That a raw log lasts."""
BAGS = {
    "bag": lambda folder: logs.write_ros2(
        folder, logs.arm_messages(logs.store(), rows=100 * SECONDS + 1), logs.store()
    ),
    "LeRobot": lambda folder: logs.write_lerobot(
        folder, 3, ["shoulder.pos", "elbow.pos"], fps=100, episodes=1
    ),
}


def told(name: str) -> list[list[str]]:
    """The arguments with which the pages start a command, each once."""
    found = [a for page, what, a in commands() if page in PAGES and what == f"experiments.{name}" and a]
    return [list(a) for a in dict.fromkeys(map(tuple, found))]


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A user's folder: a model and logs in the places that the pages name. Gives a function that runs a command."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "off")

    def friction(_model, data):
        data.qfrc_applied[0] -= 0.1 * np.tanh(data.qvel[0] / 0.03)

    for name in ("robot.xml", "my_robot.xml"):
        Path(name).write_text(ARM)
    recordings = record(ARM, [2.0, 0.5], force=friction, count=3)
    for folder in ("logs", "DIR"):
        Path(folder).mkdir()
        for r in recordings:
            np.savez(Path(folder) / f"{r.name}.npz", time=r.time, qpos=r.qpos, ctrl=r.ctrl)
    shutil.copy("logs/run_0.npz", "LOG.npz")

    def motion(_rows=0):
        (r,) = record(ARM, [2.0, 0.5], force=friction, count=1, seconds=SECONDS)
        v = np.gradient(r.qpos, r.time, axis=0)
        return {"time": r.time, "qpos": r.qpos, "qvel": v, "ctrl": r.ctrl, "force": np.full_like(v, np.nan)}

    monkeypatch.setattr(logs, "motion", motion)

    def run(name: str, arguments: list[str]) -> int:
        given = ["LOG.npz" if a == "LOG" else a for a in arguments]
        monkeypatch.setattr(sys, "argv", [name, *given])
        return MAINS[name]() if name in ("fleet", "new") else MAINS[name](given)

    return run


def verdict(out: str) -> dict:
    return json.loads((Path(out) / "diagnosis.json").read_text())


@pytest.mark.slow
def test_recordings_are_looked_at_and_diagnosed(desk, capsys):
    for name in ("inspect", "diagnose"):
        for arguments in told(name):
            if "my_bag/" not in arguments:
                assert desk(name, arguments) == 0, arguments
    assert "to diagnose: python -m experiments.diagnose --model robot.xml" in capsys.readouterr().out
    for out in ("OUT", "out"):
        (effect,) = verdict(out)["effects"]
        assert (effect["id"], effect["at"]) == ("coulomb_friction", "shoulder")
        assert (Path(out) / "report.html").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("kind", BAGS)
def test_from_a_raw_log_to_a_report_in_two_commands(desk, kind):
    BAGS[kind](Path("my_bag"))
    (looked,), (diagnosed,) = ([a for a in told(n) if "my_bag/" in a] for n in ("inspect", "diagnose"))
    assert desk("inspect", looked) == 0 and Path("inspection/map.yaml").is_file()
    assert desk("diagnose", diagnosed) == 0
    assert "coulomb_friction" in {e["id"] for e in verdict("OUT")["effects"]}
    assert Path("OUT/report.html").is_file()


@pytest.mark.slow
def test_a_fleet_is_diagnosed_and_compared_with_last_week(desk):
    shutil.rmtree("DIR")
    for robot in ("first", "second"):
        shutil.copytree("logs", Path("DIR") / robot)
    first, second = told("fleet")
    assert desk("fleet", first) == 0 and Path("OUT/fleet.html").is_file()
    Path("OUT").rename("LAST_WEEK")
    assert desk("fleet", second) == 0
    assert json.loads(Path("OUT/fleet.json").read_text())["changes"]["compared"]["robots"] == 2


def test_a_task_is_written_for_a_robot(desk, capsys, own_registry):
    (arguments,) = told("new")
    assert desk("new", arguments) == 0 and Path("my_robot.py").is_file()
    assert "python -m experiments.sweep --task my_robot.py:" in capsys.readouterr().out
