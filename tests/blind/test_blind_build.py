"""Cases: contract of the recordings, answers apart, determinism by seed, independence of the engine."""

import ast
import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import experiments.blind as package
from experiments.blind.build import build, build_case
from experiments.blind.robots.models import ROBOTS
from experiments.blind.run import run_all
from experiments.blind.truth.excitation import KINDS, reference
from experiments.blind.truth.physics import INSTALL, UNKNOWN
from experiments.blind.truth.sensors import Sensors, draw_sensors
from experiments.blind.vocabulary import PARAMETERS
from experiments.blind.wishes import Counts, Wish, wishes
from experiments.runners import Options

SOURCES = sorted(Path(package.__file__).parent.rglob("*.py"))


def test_nothing_imports_the_engine():
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{a.name}" for a in node.names]
            for name in names:
                assert not name.startswith(("mpge_jax", "envs", "experiments.diagnose")), f"{path}: {name}"
            if isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) in (
                "import_module",
                "__import__",
                "exec",
                "eval",
            ):
                raise AssertionError(f"{path} imports by name")


@pytest.mark.parametrize("name", ROBOTS)
def test_machines(name):
    robot = ROBOTS[name]
    model = mujoco.MjModel.from_xml_string(robot.spec().to_xml())  # standalone
    assert model.nu == len(model.actuator_ctrllimited.nonzero()[0])
    for effect, places in robot.places.items():
        assert effect in PARAMETERS or effect in UNKNOWN
        for at in places:
            found = [mujoco.mj_name2id(model, kind, at) for kind in (1, 3, 5, 19)]
            assert at == "world" or max(found) >= 0, (effect, at)
    assert all(
        period / robot.steps[0][0] == pytest.approx(round(period / robot.steps[0][0]))
        for period in robot.periods
    )


def test_every_effect_has_enough_machines():
    for effect in PARAMETERS:
        assert (
            sum(effect in robot.places for robot in ROBOTS.values()) >= 3 or effect == "contact_stiffness"
        ), effect
    assert (
        sum(effect in ROBOTS["boom_leg"].places for effect in ("contact_friction", "contact_stiffness")) == 2
    )
    assert set(INSTALL) == set(PARAMETERS) | set(UNKNOWN)


def test_cheetah_keeps_its_total_mass():
    model = ROBOTS["half_cheetah"].spec().compile()
    assert model.body_mass.sum() == pytest.approx(14.0)


def test_wishes_cover_the_vocabulary():
    counts = Counts()
    drawn = wishes(np.random.default_rng(0), counts)
    assert len(drawn) >= 200
    single = [w.effects[0] for w in drawn if w.kind == "single"]
    assert all(single.count(effect) >= 3 for effect in PARAMETERS)
    assert [w.kind for w in drawn[:40]].count("single") < 40  # shuffled


@pytest.mark.parametrize("kind", KINDS)
def test_references_are_smooth_and_bounded(kind):
    t = np.arange(0, 5, 0.005)
    ref = reference(kind, np.random.default_rng(3), t, np.array([0.5, -1.0]), np.array([0.3, 0.8]), 1.5)
    assert np.all(np.abs(ref.q - [0.5, -1.0]) <= np.array([0.3, 0.8]) * 1.01)
    steps = np.diff(ref.q, axis=0) / 0.005
    assert np.allclose(steps, (ref.v[1:] + ref.v[:-1]) / 2, atol=0.05 * np.abs(ref.v).max())


def test_sensors():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    rng = np.random.default_rng(0)
    q = model.qpos0.copy()
    read = Sensors(noise=1e-3, step=0.0).reader(model, rng)
    noisy = np.array([read(q, np.zeros(6))[0] for _ in range(500)])
    assert np.allclose(np.linalg.norm(noisy[:, 3:], axis=1), 1)
    assert noisy[:, :3].std(0) == pytest.approx(3e-4, rel=0.2)  # metres get less than radians
    ticks = Sensors(noise=0, jitter=0.15).ticks(0.005, 4.0, 0.0005, rng)
    gaps = np.diff(ticks)
    assert gaps.min() > 0 and gaps.std() > 0.5 and abs(np.median(gaps) - 10) <= 1
    drawn = [draw_sensors(rng) for _ in range(300)]
    assert all(1e-5 <= s.noise <= 2e-3 for s in drawn)
    assert 0.3 < np.mean([s.velocity_noise is None for s in drawn]) < 0.7


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """One single case and one null case of a quick machine with short recordings, drawn twice."""
    quick = replace(ROBOTS["pendulum"], steps=((0.001, "Euler"),), duration=(1.5, 2.0), periods=(0.01,))
    roots = [tmp_path_factory.mktemp(f"blind{i}") for i in range(2)]
    answers = []
    for root in roots:
        wish = Wish("single", ("coulomb_friction",))
        single, _ = build_case(wish, root / "cases" / "a", [5, 3], {}, (quick,))
        null, _ = build_case(Wish("null"), root / "cases" / "b", [5, 4], {}, (quick,))
        answers.append((single, null))
    return roots, answers


def test_same_seed_same_cases(small):
    roots, answers = small
    assert json.dumps(answers[0]) == json.dumps(answers[1])
    files = sorted(p.relative_to(roots[0]) for p in roots[0].rglob("*") if p.is_file())
    assert files == sorted(p.relative_to(roots[1]) for p in roots[1].rglob("*") if p.is_file())
    for file in files:
        if file.suffix == ".npz":
            one, two = np.load(roots[0] / file), np.load(roots[1] / file)
            assert sorted(one) == sorted(two) and all(np.array_equal(one[k], two[k]) for k in one)


def test_recordings_follow_the_contract(small):
    root = small[0][0]
    for case in (root / "cases").iterdir():
        assert {p.name for p in case.iterdir()} == {"model.xml", "recordings"}  # no answer beside them
        model = mujoco.MjModel.from_xml_path(str(case / "model.xml"))
        recordings = sorted((case / "recordings").iterdir())
        assert sum(p.name.startswith("heldout_") for p in recordings) == 2 and len(recordings) == 6
        for path in recordings:
            with np.load(path, allow_pickle=False) as data:
                assert (
                    {"time", "qpos", "ctrl"}
                    <= set(data)
                    <= {"time", "qpos", "qvel", "ctrl", "actuator_force"}
                )
                t = len(data["time"])
                widths = {"qpos": model.nq, "qvel": model.nv, "ctrl": model.nu, "actuator_force": model.nu}
                for key in set(data) - {"time"}:
                    assert data[key].shape == (t, widths[key]) and np.isfinite(data[key]).all()
                assert np.all(np.diff(data["time"]) > 0)
                assert 1 < data["time"][-1] - data["time"][0] < 9
                assert np.all(data["ctrl"] >= model.actuator_ctrlrange[:, 0])
                assert np.all(data["ctrl"] <= model.actuator_ctrlrange[:, 1])
                assert data["qpos"].std(0).max() > 0.01  # it moves


def test_answers(small):
    single, null = small[1][0]
    assert [e["id"] for e in single["effects"]] == ["coulomb_friction"] and null["effects"] == []
    assert single["visibility"]["coulomb_friction"] >= 12
    assert single["effects"][0]["at"] in single["places"]


def test_another_plan_is_not_mixed_in(tmp_path):
    (tmp_path / "answers").mkdir()
    (tmp_path / "answers" / "plan.json").write_text(json.dumps({"seed": 7}))
    with pytest.raises(ValueError, match="another seed"):
        build(tmp_path / "cases", tmp_path / "answers", seed=8)


FAKE = """
import json, pathlib, sys
args = dict(zip(sys.argv[1:-1:2], sys.argv[2::2]))
assert "answers" not in " ".join(sys.argv)
if "bad" in args["--model"]:
    sys.exit("error: bad")
out = pathlib.Path(args["--out"]); out.mkdir(parents=True)
(out / "diagnosis.json").write_text(json.dumps({"verdict": "none"}))
"""


def test_run_is_resumable_and_keeps_errors(tmp_path):
    script = tmp_path / "fake.py"
    script.write_text(FAKE)
    for name in ("case_good", "case_bad"):
        (tmp_path / "cases" / name).mkdir(parents=True)
        (tmp_path / "cases" / name / "model.xml").write_text("<mujoco/>")
    seen: list[tuple[int, int]] = []
    command = (sys.executable, str(script))
    arguments = {"cases": tmp_path / "cases", "out": tmp_path / "runs", "command": command}
    run_all(**arguments, progress=lambda done, total: seen.append((done, total)))
    good = json.loads((tmp_path / "runs" / "case_good" / "run.json").read_text())
    bad = json.loads((tmp_path / "runs" / "case_bad" / "run.json").read_text())
    assert good["status"] == 0 and good["seconds"] > 0 and seen[-1] == (2, 2)
    assert bad["status"] == 1 and "error: bad" in bad["stderr"]
    script.write_text("raise SystemExit(3)")
    run_all(**arguments)  # nothing is run again
    assert json.loads((tmp_path / "runs" / "case_bad" / "run.json").read_text())["status"] == 1
    run_all(**arguments, retry_failed=True)
    assert json.loads((tmp_path / "runs" / "case_bad" / "run.json").read_text())["status"] == 3
    several = {**arguments, "out": tmp_path / "several", "options": Options(workers=2)}
    run_all(**several)
    notes = [json.loads(path.read_text()) for path in sorted((tmp_path / "several").glob("*/run.json"))]
    assert [note["status"] for note in notes] == [3, 3]
    with pytest.raises(FileNotFoundError):
        run_all(tmp_path / "none", tmp_path / "runs")
    with pytest.raises(ValueError, match="no such case"):
        run_all(**arguments, only=("case_9",))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a process with the one that started it")
def test_a_diagnosis_ends_with_the_process_that_waits_for_it(tmp_path):
    script, note = tmp_path / "fake.py", tmp_path / "pid"
    script.write_text(
        f"import os, time\nopen({str(note)!r}, 'w').write(f'{{os.getpid()}}.')\ntime.sleep(60)\n"
    )
    code = f"""
from pathlib import Path
from experiments.blind.run import CaseJob, run_case
folder = Path({str(tmp_path)!r})
run_case(CaseJob(folder, folder / "out", 1, 0, 60.0, ({sys.executable!r}, {str(script)!r})))
"""
    waiting = subprocess.Popen([sys.executable, "-c", code])
    while not (note.exists() and note.read_text().endswith(".")):
        assert waiting.poll() is None
        time.sleep(0.05)
    waiting.kill()
    waiting.wait()
    process = Path("/proc") / note.read_text()[:-1] / "stat"
    for _ in range(400):
        if not process.exists() or process.read_text().rpartition(")")[2].split()[0] == "Z":
            break
        time.sleep(0.05)
    else:
        pytest.fail("the diagnosis goes on alone")
    assert not (tmp_path / "out" / "run.json").exists()
