"""What a rule does, counted over diagnoses with and without it."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from experiments.ablation import __main__ as command
from experiments.ablation.compared import Effect, acted, cases_of, effect, place, public
from experiments.ablation.one import ALL
from experiments.ablation.table import BEGIN, END, verdict
from experiments.atlas.machines import MACHINES, Machine
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.evidence import scored

FRICTION, DAMPING, GAIN = (
    ("coulomb_friction", "hinge"),
    ("viscous_damping", "hinge"),
    ("actuator_gain", "motor"),
)


def report(*named: tuple[str, str]) -> dict:
    effects = [{"id": i, "at": at, "parameters": {}, "error_drop": 0.5} for i, at in named]
    return {
        "verdict": "effects" if named else "none",
        "effects": effects,
        "ambiguous": [],
        "unexplained": None,
    }


def answer(case: str, *hidden: tuple[str, str]) -> dict:
    effects = [
        {"id": i, "at": at, "parameters": {}, "same_place": [], "twins": [], "coin": False}
        for i, at in hidden
    ]
    return {
        "case": case, "kind": "single" if hidden else "null", "model": "pendulum", "effects": effects, "unknown": [],
        "concealed": [], "visibility": {}, "places": {}, "plane": None,
    }  # fmt: skip


@pytest.fixture
def ran(tmp_path: Path) -> Path:
    """Three cases with friction, diagnosed with all rules, and two of them without `named`, which acted in these."""
    out = tmp_path / "out"
    with_all = {"case_0": [FRICTION], "case_1": [FRICTION], "case_2": [DAMPING]}
    without = {"case_0": [FRICTION], "case_1": [FRICTION, GAIN]}
    for name in with_all:
        folder = tmp_path / "cases7" / "cases" / name
        folder.mkdir(parents=True)
        (folder / "model.xml").write_text("<mujoco/>")
        answers = tmp_path / "cases7" / "answers"
        answers.mkdir(exist_ok=True)
        (answers / f"{name}.json").write_text(json.dumps(answer(name, FRICTION)))
    for case in cases_of((tmp_path / "cases7",)):
        for rule, said in ((ALL, with_all), ("named", without)):
            if case.folder.name not in said:
                continue
            at = place(out, rule, case)
            (at / "report").mkdir(parents=True)
            (at / "run.json").write_text(json.dumps({"status": 0}))
            (at / "report" / "diagnosis.json").write_text(json.dumps(report(*said[case.folder.name])))
            acts = ["named"] if rule == ALL and case.folder.name != "case_2" else []
            (at / "report" / "acted.json").write_text(json.dumps(acts))
    return out


def test_only_cases_in_which_a_rule_acted_count(ran: Path) -> None:
    cases = cases_of((ran.parent / "cases7",))
    assert [acted(ran, c) for c in cases] == [{"named"}, {"named"}, set()]
    acts = {c: acted(ran, c) for c in cases}
    assert effect(ran, "named", acts) == Effect(cases=2, run=2, changed=1, better=1, worse=0)
    assert effect(ran, "tie", acts) == Effect(cases=0, run=0, changed=0, better=0, worse=0)


def test_a_rule_is_needed_once_chance_is_ruled_out() -> None:
    assert not Effect(9, 9, 5, 5, 0).needed  # one in 32
    assert Effect(9, 9, 6, 6, 0).needed
    assert not Effect(20, 20, 12, 8, 4).needed
    assert not Effect(0, 0, 0, 0, 0).needed


@pytest.mark.parametrize(
    ("effect_of", "said"),
    [
        (Effect(90, 30, 9, 9, 0), "needed"),
        (Effect(90, 30, 3, 2, 1), "not all run"),
        (Effect(90, 90, 1, 1, 0), "fewer than 1 % change"),
        (Effect(1, 0, 0, 0, 0), "fewer than 1 % change"),
        (Effect(90, 90, 9, 5, 3), "no better without it"),
        (Effect(90, 90, 9, 3, 5), "no worse without it"),
    ],
)
def test_a_rule_in_a_few_words(effect_of: Effect, said: str) -> None:
    assert verdict(200, effect_of) == said


def test_the_page_has_every_rule(ran: Path, tmp_path: Path) -> None:
    page = tmp_path / "ablation.md"
    page.write_text(f"# Rules\n\n{BEGIN}\n{END}\n\nin words\n")
    (ran / "public").mkdir()
    for key, acts in (("brfd", ["named"]), ("ur10_bag", [])):
        public(ran, key).write_text(json.dumps(acts))
    given = ["table", "--cases", str(tmp_path / "cases7"), "--out", str(ran), "--page", str(page)]
    assert command.main(given) == 0
    text = page.read_text()
    assert text.startswith("# Rules") and text.endswith("in words\n")
    assert "3 cases" in text and "2 public machines" in text
    assert (
        "| named | parameters differ from where the effect vanishes | `NAMED` | 1 | 2 | 2 | 1 | 1 | 0 |"
        in text
    )
    assert (
        "| tie | what the ratio does not tell apart is a tie | `SURE` | 0 | 0 | 0 | 0 | 0 | 0 | fewer than 1 % change |"
        in text
    )


def test_folders_without_cases_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["table", "--cases", str(tmp_path), "--out", str(tmp_path)]) == 2
    assert "no cases in" in capsys.readouterr().err


def test_rules_are_watched_on_public_machines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for key in ("brfd", "ur10_bag"):
        folder = tmp_path / "recordings" / MACHINES[key].folder
        folder.mkdir(parents=True)
        (folder / "model.xml").write_text("<mujoco/>")
    seen = []

    def diagnosed(machine: Machine, recordings: Path, jobs: int) -> None:
        seen.append(machine.key)
        # a rule acts: of four hopeless families one is dropped
        terms = [Term("armature", Place("joint", f"joint_{k}", k)) for k in range(4)]
        few = [SimpleNamespace(loss=9.0 + 0.1 * k, hypothesis=Hypothesis.of(t)) for k, t in enumerate(terms)]
        few[0].loss = 1.0
        scored.hopeful(few, 10.0)  # type: ignore[arg-type]

    monkeypatch.setattr(command, "diagnosed", diagnosed)
    given = ["public", "--recordings", str(tmp_path / "recordings"), "--out", str(tmp_path / "out")]
    assert command.main(given) == 0 and command.main(given) == 0
    assert seen == ["brfd", "ur10_bag"]
    assert json.loads(public(tmp_path / "out", "brfd").read_text()) == ["hopeful"]


@pytest.mark.parametrize("key", ["nobody", "go2_legs"])
def test_a_public_machine_that_is_not_there(
    tmp_path: Path, key: str, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["public", "--recordings", str(tmp_path), "--out", str(tmp_path / "out"), "--machine", key]
    assert command.main(given) == 2
    assert ("there is no machine 'nobody'" in (said := capsys.readouterr().err)) or "has no go2_legs" in said


def test_the_page_of_the_documentation_has_its_place_for_the_table() -> None:
    before, _, rest = Path("docs/ablation.md").read_text("utf-8").partition(BEGIN)
    assert before.startswith("# Which rules decide anything") and "| named |" in rest.partition(END)[0]
