"""The second author's cases: valid answers, recordings that the diagnosis reads, the same files for the same seed."""

import json

import mujoco
import numpy as np
import pytest

from experiments.blind.scoring.figures import summary
from experiments.blind.scoring.marks import judge
from experiments.blind.visibility.equivalence import drive_train
from experiments.blind.vocabulary import Effect as Known
from experiments.second_author.__main__ import main
from experiments.second_author.build import answer, build, same_drive
from experiments.second_author.cases import CASES
from mpge_jax.diagnosis import REGISTRY
from mpge_jax.diagnosis.effects.base import find_place
from mpge_jax.diagnosis.effects.context import nominal_context
from mpge_jax.diagnosis.machine.model import compile_variable, load_spec, names_of
from mpge_jax.diagnosis.recordings.reader import read

NAMES = [case.name for case in CASES]
FIELDS = {
    "case", "schema", "kind", "model", "plane", "effects", "unknown", "places", "visibility", "concealed", "sensors",
}  # fmt: skip
BUILT = ("case_08_cart_pole", "case_18_balancer", "case_30_quadrotor")
SECONDS = 1.1


def the(name):
    return next(case for case in CASES if case.name == name)


def test_there_are_thirty_of_all_kinds():
    assert [case.number for case in CASES] == list(range(1, 31))
    kinds = [case.kind for case in CASES]
    wanted = {"null": 5, "single": 12, "pair": 4, "triple": 2, "whole": 3, "unknown": 2, "mixed": 2}
    assert {kind: kinds.count(kind) for kind in kinds} == wanted


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_every_case_has_a_valid_answer(case):
    told = json.loads(json.dumps(answer(case, {})))
    assert set(told) == FIELDS
    counts = len(told["effects"]), len(told["unknown"])
    assert {
        "null": counts == (0, 0), "single": counts == (1, 0), "pair": counts == (2, 0), "triple": counts == (3, 0),
        "whole": counts[0] >= 8 and not counts[1], "unknown": counts == (0, 1), "mixed": counts == (1, 1),
    }[case.kind]  # fmt: skip
    context = nominal_context(mujoco.MjModel.from_xml_string(case.xml))
    for e in told["effects"]:
        Known(e["id"], e["at"], e["parameters"])  # the parameters have the names that reports give them
        same = [(e["id"], at) for at in e["same_place"]]
        for name, at in [(e["id"], e["at"]), *map(tuple, e["twins"]), *same]:
            assert find_place(context, REGISTRY[name], at).name == at
    for row in told["effects"] + told["unknown"]:
        assert row["at"] in told["places"] and row["at"] in told["places"][row["at"]]
    for at, names in told["places"].items():
        assert set(names) == drive_train(context.model, at)
    assert {*case.twins, *case.same_place} <= {e["id"] for e in told["effects"]}


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_a_report_that_says_what_is_hidden_has_full_marks(case):
    told = answer(case, {})
    report = {"verdict": "effects" if told["effects"] else "none", "effects": told["effects"]}
    if told["unknown"]:
        report |= {"verdict": "unexplained", "unexplained": {"at": [told["unknown"][0]["at"]]}}
    mark = judge(told, report, 1.0)
    assert mark.exact == 1 and not mark.wrong and not mark.alarm


def test_what_cannot_be_told_apart_is_not_wrong():
    def named(name, *effects):
        entries = [{"id": i, "at": at} for i, at in effects]
        return judge(answer(the(name), {}), {"verdict": "effects", "effects": entries}, 1.0)

    assert not named("case_23_arm6", ("back_emf", "t5")).wrong
    assert named("case_23_arm6", ("back_emf", "t4")).wrong
    other_finger = ("coulomb_friction", "slide_r"), ("joint_stiffness", "pitch")
    assert named("case_20_gripper", *other_finger).exact == 1


def test_a_model_that_is_exact_as_given_is_not_predicted_worse():
    mark = judge(answer(the("case_02_rover"), {}), {"verdict": "none", "effects": []}, 1.0)
    mark.judged = 1e-14, 1e-14
    assert summary([mark])["the scorer's own recordings predicted worse, by a tenth"]["value"] == 0


def test_drives_go_by_the_names_of_all_their_parts():
    m = mujoco.MjModel.from_xml_string(the("case_01_arm6").xml)
    for at in ("j3", "link3", "t3"):
        assert same_drive(m, at) == {"j3", "link3", "t3"}
    assert same_drive(m, "world") == {"world"}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Three cases with short recordings, twice with the same seed and once with another."""
    out = [tmp_path_factory.mktemp(f"second{i}") for i in range(3)]
    for folder, seed, only in zip(out, (0, 0, 1), (BUILT, BUILT[:1], BUILT[:1]), strict=True):
        assert build(folder / "cases", folder / "answers", only, seed, longest=SECONDS) == len(only)
    return out


@pytest.mark.parametrize("name", BUILT)
def test_the_diagnosis_reads_what_is_built(built, name):
    folder = built[0] / "cases" / name
    assert {p.name for p in folder.iterdir()} == {"model.xml", "recordings"}
    model = compile_variable(load_spec(folder / "model.xml"))
    recordings = read(folder / "recordings", model, names_of(model))
    shown, _ = the(name).runs()
    assert [r.name for r in recordings] == [f"{i:02d}_{run.name}" for i, run in enumerate(shown, 1)]
    for r in recordings:
        rows = len(r.time)
        assert rows == pytest.approx(SECONDS * the(name).rate, abs=1)
        assert r.qpos.shape == (rows, model.nq) and r.ctrl.shape == (rows, model.nu)
        assert np.all(r.ctrl >= model.actuator_ctrlrange[:, 0]) and np.isfinite(r.qpos).all()
        measured = name == "case_30_quadrotor"
        assert (r.qvel is not None) == measured


@pytest.mark.parametrize("name", BUILT)
def test_recordings_that_judge_are_true_states(built, name):
    folder = built[0] / "answers"
    told = json.loads((folder / f"{name}.json").read_text())
    model = mujoco.MjModel.from_xml_string(the(name).xml)
    assert set(told["visibility"]) == {e["id"] for e in told["effects"] + told["unknown"]}
    assert all(x > 0 for x in told["visibility"].values())
    for number in range(2):
        with np.load(folder / f"{name}_judge_{number}.npz", allow_pickle=False) as run:
            assert set(run) == {"time", "qpos", "qvel", "ctrl"}
            assert run["qvel"].shape == (len(run["time"]), model.nv)
            # without noise positions are the integral of velocities
            moved, mean = np.diff(run["qpos"][:, 0]), (run["qvel"][1:, 0] + run["qvel"][:-1, 0]) / 2
            assert np.abs(moved - mean * np.diff(run["time"])).max() < 2e-4


def test_the_same_seed_gives_the_same_files(built):
    first, again, other = built
    files = [p.relative_to(again) for p in sorted(again.rglob("*")) if p.is_file() and p.name != "plan.json"]
    assert len(files) == 1 + len(the(BUILT[0]).runs()[0]) + 1 + 2
    for file in files:
        assert (first / file).read_bytes() == (again / file).read_bytes(), file
    for file in ("cases/case_08_cart_pole/recordings/01_sines.csv", "answers/case_08_cart_pole_judge_0.npz"):
        assert (other / file).read_bytes() != (again / file).read_bytes()


def test_finished_cases_are_kept_and_other_seeds_are_not_mixed_in(built):
    _, again, _ = built
    target = again / "answers" / f"{BUILT[0]}.json"
    before = target.stat().st_mtime_ns
    build(again / "cases", again / "answers", BUILT[:1], 0, longest=SECONDS)
    assert target.stat().st_mtime_ns == before
    with pytest.raises(ValueError, match="another seed"):
        build(again / "cases", again / "answers", BUILT[:1], 1, longest=SECONDS)


def test_an_unknown_name_is_one_sentence(tmp_path, capsys):
    assert main(["build", "--out", str(tmp_path / "out"), "--only", "case_8"]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("second_author: no such case: case_8; ") and "list" in said
    assert not (tmp_path / "out").exists()


def test_the_cases_are_listed(capsys):
    assert main(["list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == NAMES
