"""The rival that is told the true effects and fits their sizes alone."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments.blind import __main__ as command
from experiments.blind import told
from experiments.blind.scoring.figures import summary
from experiments.blind.scoring.marks import Mark
from experiments.blind.scoring.score import load_marks
from experiments.blind.told import Rival, _smoothed
from experiments.blind.truth.physics import stages_of
from experiments.blind.truth.plant import Plant
from experiments.blind.truth.sensors import Sensors
from experiments.blind.truth.simulate import simulate
from experiments.blind.vocabulary import Effect

XML = """
<mujoco><option timestep="0.005"/><worldbody><body name="rod">
  <joint name="hinge" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.5"/>
</body></worldbody><actuator><motor name="motor" joint="hinge"/></actuator></mujoco>
"""
DAMPING = Effect("viscous_damping", "hinge", {"coefficient": 0.05})
GAIN = Effect("actuator_gain", "motor", {"gain": 0.8})
LATE = "commands logged a row late"


def _columns(model: Path, effects: list[Effect], seed: int, rows: int = 250) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * 0.01
    ctrl = 0.8 * np.sin(2 * np.pi * (0.6 + 0.3 * seed) * t + rng.uniform(0, 6))[:, None]
    plant = Plant(str(model), 0.005, "Euler", stages_of(effects))
    ticks = np.arange(rows) * 2
    run = simulate(plant, ctrl, ticks, 0, (np.array([0.3]), np.zeros(1)), Sensors(noise=1e-4), rng)
    return {"time": t + 3.0, "qpos": run.measured_qpos, "qvel": run.qvel, "ctrl": run.ctrl}


def _case(folder: Path, effects: list[Effect], late: bool = False, unknown: bool = False) -> dict:
    """A case with its answer and the two recordings that judge it."""
    recordings = folder / "cases" / "case_000" / "recordings"
    recordings.mkdir(parents=True)
    (folder / "answers").mkdir()
    model = recordings.parent / "model.xml"
    model.write_text(XML)
    for seed in range(2):
        columns = _columns(model, effects, seed)
        if late:
            columns["ctrl"] = np.concatenate([columns["ctrl"][:1], columns["ctrl"][:-1]])
        del columns["qvel"]
        np.savez(recordings / f"rec_{seed}.npz", **columns)
        np.savez(folder / "answers" / f"case_000_judge_{seed}.npz", **_columns(model, effects, 7 + seed))
    answer = {
        "case": "case_000",
        "kind": "single",
        "model": "rod",
        "plane": [],
        "places": {e.at: [e.at] for e in effects},
        "effects": [e.as_json() | {"twins": [], "coin": False, "same_place": []} for e in effects],
        "unknown": [{"id": "odd", "at": "hinge", "parameters": {}}] if unknown else [],
        "concealed": ["true step 0.005 s, Euler", *([LATE] if late else [])],
    }
    (folder / "answers" / "case_000.json").write_text(json.dumps(answer))
    return answer


def test_sizes_are_those_that_the_recordings_show_not_those_that_were_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    # three are enough: all further ones look for what is better by less than a millionth
    monkeypatch.setattr(told, "ITERATIONS", 3)
    answer = _case(tmp_path, [DAMPING, GAIN])
    for e, wrong in zip(answer["effects"], ({"coefficient": 0.08}, {"gain": 0.6}), strict=True):
        e["parameters"] = wrong
    damping, gain = Rival.of(tmp_path / "cases" / "case_000", answer).fitted()
    assert damping.number("coefficient") == pytest.approx(0.05, rel=0.1)
    assert gain.number("gain") == pytest.approx(0.8, rel=0.03)


@pytest.mark.parametrize("late", [False, True])
def test_a_command_acts_when_it_was_given_logged_a_row_late_or_not(tmp_path: Path, late: bool):
    windows = Rival.of(tmp_path / "cases" / "case_000", _case(tmp_path, [], late)).windows
    model = tmp_path / "cases" / "case_000" / "model.xml"
    given_of = [_columns(model, [], seed)["ctrl"] for seed in range(2)]
    assert len(windows) == told.WINDOWS
    for number, w in enumerate(windows):
        rows = round((w.begin - 3.0) / 0.01) + np.arange(len(w.ctrl))
        np.testing.assert_array_equal(w.ctrl, given_of[2 * number // told.WINDOWS][rows])


def test_vectors_and_whole_numbers():
    tilt = Effect("gravity_tilt", "world", {"angle": 0.1, "axis": [1.0, 0.0, 0.0]})
    wave = Effect("cogging_torque", "hinge", {"amplitude": 0.2, "periods": 6, "phase": 0.5})
    rival = Rival(Path("model.xml"), (tilt, wave), 0.001, "Euler", ())
    np.testing.assert_array_equal(rival.sizes, [0.1, 1.0, 0.0, 0.0, 0.2, 0.5])
    other = rival.sized(np.arange(6.0))
    assert other[0].parameters == {"angle": 0.0, "axis": [1.0, 2.0, 3.0]}
    assert other[1].parameters == {"amplitude": 4.0, "periods": 6, "phase": 5.0}
    assert rival.fitted() == (tilt, wave)


def test_a_window_starts_on_a_smoothed_that_follows_no_stray_reading(tmp_path: Path):
    _case(tmp_path, [])
    rival = Rival.of(
        tmp_path / "cases" / "case_000", json.loads((tmp_path / "answers/case_000.json").read_text())
    )
    t = np.arange(40) * 0.01
    run = {"time": t, "qpos": (0.2 + 1.5 * t - 2.0 * t**2)[:, None]}
    run["qpos"][18] += 0.4
    model = Plant(str(rival.model), 0.005, "Euler", stages_of([])).nominal
    q, v = _smoothed(model, run, 0.203)
    assert q[0] == pytest.approx(0.2 + 1.5 * 0.203 - 2.0 * 0.203**2, abs=2e-3)
    assert v[0] == pytest.approx(1.5 - 4.0 * 0.203, abs=0.2)


def test_the_same_recordings_judge_rival_and_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(told, "WINDOWS", 6)
    _case(tmp_path, [GAIN])
    out, runs = tmp_path / "told", tmp_path / "runs" / "case_000"
    given = [
        "told",
        "--cases",
        str(tmp_path / "cases"),
        "--answers",
        str(tmp_path / "answers"),
        "--out",
        str(out),
    ]
    assert command.main(given) == 0
    table = out / "case_000" / "report" / "effects.json"
    assert json.loads(table.read_text())["effects"][0]["kind"] == "actuator"
    before = table.stat().st_mtime_ns
    assert command.main(given) == 0 and table.stat().st_mtime_ns == before
    (runs / "report").mkdir(parents=True)
    (runs / "run.json").write_text(json.dumps({"status": 0, "seconds": 1.0}))
    report = {"verdict": "effects", "effects": [{"id": "actuator_gain", "at": "motor", "parameters": {}}]}
    (runs / "report" / "diagnosis.json").write_text(
        json.dumps(report | {"ambiguous": [], "unexplained": None})
    )
    (runs / "judged.json").write_text("[0.5, 0.02]")
    (out / "case_000" / "judged.json").write_text("[0.5, 0.01]")
    (mark,) = load_marks(tmp_path / "answers", runs.parent, told=out)
    assert mark.judged == (0.5, 0.02) and mark.told == 0.01
    row = next(r for name, r in summary([mark]).items() if "told the names" in name)
    assert (row["value"], row["of"], row["passed"]) == (pytest.approx(2.0), 1, False)


def test_what_is_outside_of_the_vocabulary_has_no_rival(tmp_path: Path):
    _case(tmp_path, [GAIN], unknown=True)
    given = ["told", "--cases", str(tmp_path / "cases"), "--answers", str(tmp_path / "answers")]
    assert command.main([*given, "--out", str(tmp_path / "told")]) == 0
    assert not (tmp_path / "told").exists()


def test_a_case_that_is_named_in_part_is_not_compared():
    marks = [
        Mark("a", "single", "rod", [], "", "effects", 1.0, exact=x, judged=(1.0, 0.2), told=0.1, seen=50.0)
        for x in (1.0, 0.5)
    ]
    row = next(r for name, r in summary(marks).items() if "told the names" in name)
    assert row["of"] == 1
