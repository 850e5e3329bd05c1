"""The command, on diagnoses that cost nothing: what it refuses, skips, compares and writes."""

import html
import json
import sys
from urllib.parse import quote

import numpy as np
import pytest

from experiments.fleet import __main__ as command
from experiments.fleet import robot
from experiments.fleet.comparison import compare
from experiments.fleet.page import lead
from mpge_jax import files, own_code
from mpge_jax.diagnosis import InputError
from mpge_jax.diagnosis.recordings.formats import own_readers, registry
from tests.diagnosis.machines import PENDULUM


def entry(value: float, half: float = 0.004, unit: str = "N m") -> dict:
    return {"value": value, "low": value - half, "high": value + half, "unit": unit}


def friction(value: float) -> dict:
    return {"id": "coulomb_friction", "at": "hinge", "parameters": {"torque": entry(value)}}


DEAD = {"id": "dead_actuator", "at": "motor", "parameters": {}}
GAIN = {"id": "actuator_gain", "at": "motor", "parameters": {"gain": entry(0.8, unit="1")}}


def table(*effects: dict, verdict: str = "effects", candidates: tuple = ()) -> dict:
    ambiguous = [{"candidates": list(candidates)}] if candidates else []
    return {"verdict": verdict, "explanation": "Told.", "effects": list(effects), "ambiguous": ambiguous}


USUAL = (0.100, 0.104, 0.097, 0.101, 0.103, 0.099)


@pytest.fixture
def fleet(monkeypatch, tmp_path):
    """A fleet of robots whose diagnoses are known: six alike, one with more friction, one dead, one undecided, one
    whose recording is no good. Gives a function that runs the command and one list of what was diagnosed."""
    said = {f"robot_{n}": table(friction(value)) for n, value in enumerate(USUAL)}
    said["odd"] = table(friction(0.2))
    said["dead"] = table(DEAD)
    said["either"] = table(verdict="ambiguous", candidates=([GAIN], [friction(0.102)]))
    (tmp_path / "model.xml").write_text(PENDULUM)
    for name in (*said, "broken"):
        files.write_text(tmp_path / "robots" / name / "run_0.csv", name)
    ran = []

    class Told:
        def __init__(self, name):
            self.name = name

        def write(self, folder):
            files.write_text(folder / "diagnosis.json", json.dumps(said[self.name]))

    def fake(model, recordings, config, columns, progress):
        (folder,) = recordings
        ran.append(folder.name)
        if folder.name == "broken":
            raise InputError("run_0: time repeats at row 2 <b>; sort the rows.")
        return Told(folder.name)

    monkeypatch.setattr(robot, "diagnose", fake)

    def run(*more, out="out"):
        arguments = ["--model", tmp_path / "model.xml", "--robots", tmp_path / "robots"]
        monkeypatch.setattr(sys, "argv", ["fleet", *map(str, [*arguments, "--out", tmp_path / out, *more])])
        return command.main()

    run.said, run.ran, run.folder = said, ran, tmp_path
    return run


def test_odd_robots_come_first_and_failures_stop_nothing(fleet, capsys):
    assert fleet() == 1
    found = json.loads((fleet.folder / "out" / "fleet.json").read_text())
    assert len(fleet.ran) == 10 and len(found["robots"]) == 9
    assert found["failed"] == [
        {"robot": "broken", "reason": "run_0: time repeats at row 2 <b>; sort the rows."}
    ]
    odd = {each["robot"]: each["reasons"] for each in found["odd"]}
    assert list(odd) == ["dead", "odd"]
    assert odd["odd"][0].startswith("torque of coulomb friction at hinge is 0.2 N m, ")
    assert odd["odd"][0].endswith("standard deviations above the others' 0.101")
    assert odd["dead"] == [
        "without coulomb friction at hinge, which 8 of 9 robots have",
        "with dead actuator at motor, which no other robot has",
    ]
    shared, own = found["effects"]
    assert shared["shared"] and shared["without"] == ["dead"] and not own["shared"]
    torque = shared["parameters"]["torque"]
    usual = [*USUAL, 0.102]
    # All errors are alike, so the shared value is the mean, and tau^2 the variance beyond a robot's own.
    assert torque["value"] == pytest.approx(np.mean(usual))
    assert torque["spread"] ** 2 == pytest.approx(np.var(usual, ddof=1) - (0.004 / 1.959964) ** 2, abs=1e-12)
    assert list(torque["stand_out"]) == ["odd"]
    # What its own recordings leave open, the others decide.
    (decided,) = found["robots"]["either"]["effects"]
    assert decided["id"] == "coulomb_friction" and decided["decided_by_the_fleet"]
    nearer = found["robots"]["robot_1"]["effects"][0]["parameters"]["torque"]["given_the_fleet"]
    assert torque["value"] < nearer < 0.104
    page = (fleet.folder / "out" / "fleet.html").read_text()
    assert "row 2 &lt;b&gt;" in page and 'href="robots/odd/report.html"' in page
    text = (fleet.folder / "out" / "fleet.md").read_text()
    assert (
        text.index("| broken |")
        < text.index("[dead]")
        < text.index("[odd]")
        < text.index("## What the fleet")
    )
    assert (fleet.folder / "out" / "fleet.png").read_bytes().startswith(b"\x89PNG")
    assert "9 robots were diagnosed, 1 could not be; 2 are odd" in capsys.readouterr().out


def test_a_fleet_of_which_nothing_could_be_diagnosed_is_told_as_that():
    assert lead(compare({}, {"r1": "no file", "r2": "no file"})) == "None of 2 robots could be diagnosed."


def test_names_of_robots_and_joints_are_text_on_the_page(fleet):
    evil = "<img src=x onerror=alert(1)>"
    (fleet.folder / "robots" / "odd").rename(fleet.folder / "robots" / evil)
    bad = friction(0.2) | {"at": "<script>alert(2)</script>"}
    fleet.said[evil] = table(bad) | {"explanation": "<script>alert(3)</script>"}
    fleet()
    page = (fleet.folder / "out" / "fleet.html").read_text()
    assert "<script" not in page and "<img src=x" not in page
    assert html.escape(evil) in page and html.escape(bad["at"]) in page
    assert f'href="robots/{quote(evil)}/report.html"' in page


def test_what_is_done_stands_until_its_recordings_change(fleet):
    fleet()
    fleet.ran.clear()
    before = (fleet.folder / "out" / "fleet.json").read_bytes()
    assert fleet() == 1
    assert fleet.ran == ["broken"]
    assert (fleet.folder / "out" / "fleet.json").read_bytes() == before
    (fleet.folder / "robots" / "odd" / "run_1.csv").write_text("one more")
    fleet()
    assert sorted(fleet.ran) == ["broken", "broken", "odd"]


def test_logs_of_ones_own_are_read_by_every_job_and_count_as_input(fleet, monkeypatch, capsys):
    monkeypatch.setattr(registry, "OWN", before := [])
    monkeypatch.setattr(own_readers, "OWN", before)
    monkeypatch.setattr(own_readers, "_read", {})
    monkeypatch.setattr(own_code, "_loaded", {})
    text = "from mpge_jax.diagnosis import register_reader\n@register_reader('mine', '.trc')\ndef read(path): ...\n"
    reader = fleet.folder / "mine.py"
    reader.write_text(text)
    fleet("--reader-file", reader)
    assert "mine.py" in json.loads((fleet.folder / "out" / "settings.json").read_text())["files"]
    # A job loads them by itself, as it may run in another process.
    loaded = []
    monkeypatch.setattr(robot, "load_readers", loaded.append)
    given = robot.RobotJob(
        robot.Settings(fleet.folder / "model.xml", reader_files=(reader,)),
        fleet.folder / "robots" / "odd",
        fleet.folder / "again",
    )
    robot.diagnose_robot(given)
    assert loaded == [reader]
    capsys.readouterr()
    reader.write_text(text + "# other\n")
    assert fleet("--reader-file", reader) == 2
    assert "holds another fleet (files differ)" in capsys.readouterr().err


def test_this_week_against_last_week(fleet, capsys):
    fleet()
    # Every robot has a little more friction, one lost its motor, and one recording is good again.
    for name, value in zip([f"robot_{n}" for n in range(6)], USUAL, strict=True):
        fleet.said[name] = table(friction(value + 0.004))
    fleet.said["robot_5"] = table(friction(0.15))
    fleet.said["odd"] = table(friction(0.2), DEAD)
    fleet("--before", fleet.folder / "out", out="now")
    changes = json.loads((fleet.folder / "now" / "fleet.json").read_text())["changes"]
    changed = {each["robot"]: each for each in changes["robots"]}
    assert list(changed) == ["robot_5", "odd"]
    (step,) = changed["robot_5"]["parameters"]
    assert (step["before"], step["now"]) == pytest.approx((0.099, 0.15)) and step["chance"] < 1e-6
    assert changed["odd"]["new"] == [["dead_actuator", "motor"]] and not changed["odd"]["gone"]
    assert changes["compared"]["robots"] == 9 and changes["joined"] == changes["left"] == []
    assert "from 0.099 to 0.15 N m" in (fleet.folder / "now" / "fleet.md").read_text()
    capsys.readouterr()
    assert fleet("--before", fleet.folder / "nowhere", out="third") == 2
    assert "holds no finished fleet (fleet.json)" in capsys.readouterr().err
    assert not (fleet.folder / "third").exists()


def test_a_change_of_the_whole_fleet_is_told(fleet):
    fleet()
    for name, value in zip([f"robot_{n}" for n in range(6)], USUAL, strict=True):
        fleet.said[name] = table(friction(value + 0.006))
    fleet("--before", fleet.folder / "out", out="now")
    (step,) = json.loads((fleet.folder / "now" / "fleet.json").read_text())["changes"]["fleet"]
    assert step["now"] - step["before"] == pytest.approx(6 * 0.006 / 8) and step["robots"] == 8


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--effects", "friction"], "--effects friction is not known"),
        (["--workers", "0"], "--workers must be at least 1"),
        (["--map", "nowhere.yaml"], "cannot read the map nowhere.yaml"),
        (["--seed", "-1"], "seed must not be negative"),
        (["--robots", "nowhere"], "--robots nowhere is not a folder"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_written(fleet, capsys, more, message):
    assert fleet(*more) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith(f"fleet: {message}") and "\n" not in said
    assert fleet.ran == [] and not (fleet.folder / "out").exists()


def test_folders_of_others_are_refused_and_kept(fleet, capsys):
    fleet("--seed", "1", out="other")
    assert fleet(out="other") == 2
    assert "holds another fleet (seed differ)" in capsys.readouterr().err
    (fleet.folder / "full").mkdir()
    (fleet.folder / "full" / "thesis.tex").write_text("important")
    assert fleet(out="full") == 2
    assert "is not empty and holds no fleet" in capsys.readouterr().err
    (fleet.folder / "empty").mkdir()
    assert fleet("--robots", fleet.folder / "empty") == 2
    assert "has no folders" in capsys.readouterr().err
