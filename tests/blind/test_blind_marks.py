"""Marking against reports written by hand."""

import json
import math

import pytest

from experiments.blind.scoring.figures import summary
from experiments.blind.scoring.marks import judge
from experiments.blind.scoring.parameters import compare
from experiments.blind.scoring.score import BEGIN, END, load_marks, put_into, write_score


def hidden(*effects: dict, kind: str = "single", unknown: tuple[dict, ...] = (), **more) -> dict:
    filled = [{"twins": [], "coin": False, "same_place": [], "parameters": {}, **e} for e in effects]
    places = {e["at"]: [e["at"], f"{e['at']}_motor", f"{e['at']}_body"] for e in [*effects, *unknown]}
    base = {
        "case": "case_000",
        "kind": kind,
        "model": "arm",
        "plane": [0, 2],
        "concealed": ["noise 1.0e-04 rad"],
    }
    return base | {"effects": filled, "unknown": list(unknown), "places": places} | more


def report(*effects: dict, verdict: str = "effects", **more) -> dict:
    fit = {"held_out": {"before": 0.2, "after": 0.01}}
    return {
        "schema": 1,
        "verdict": verdict,
        "effects": list(effects),
        "ambiguous": [],
        "unexplained": None,
        "fit": fit,
    } | more


FRICTION = {"id": "coulomb_friction", "at": "elbow", "parameters": {"torque": 0.7}}
NAMED = {
    "id": "coulomb_friction",
    "at": "elbow",
    "parameters": {"torque": {"value": 0.72, "low": 0.68, "high": 0.76}},
}
VISCOUS = {"id": "viscous_damping", "at": "elbow", "parameters": {}}


def test_exactly_named():
    mark = judge(hidden(FRICTION), report(NAMED), 3.0)
    assert (mark.exact, mark.place, mark.drop) == (1.0, True, 20.0)
    assert mark.parameters[0].error == pytest.approx(0.02 / 0.7)
    assert mark.parameters[0].within and mark.parameters[0].contained == (True,)


def test_wrong_name_in_the_right_place():
    mark = judge(hidden(FRICTION), report(VISCOUS), 3.0)
    assert (mark.exact, mark.place) == (0.0, True)
    motor = judge(hidden(FRICTION), report({"id": "actuator_gain", "at": "elbow_motor"}), 3.0)
    assert (motor.exact, motor.place) == (0.0, True)
    far = judge(hidden(FRICTION), report({"id": "coulomb_friction", "at": "wrist"}), 3.0)
    assert (far.exact, far.place) == (0.0, False)


def test_one_effect_too_many_is_not_exact_but_the_leading_place_counts():
    extra = {"id": "viscous_damping", "at": "wrist", "error_drop": 0.02}
    mark = judge(hidden(FRICTION), report(extra, NAMED | {"error_drop": 0.9}), 3.0)
    assert (mark.exact, mark.place) == (0.0, True)


def test_leftover_is_not_exact():
    verdict = report(NAMED, verdict="unexplained", unexplained={"at": ["elbow"]})
    assert judge(hidden(FRICTION), verdict, 3.0).exact == 0.0


def ambiguous(*candidates: dict, sure: tuple[dict, ...] = ()) -> dict:
    return report(*sure, verdict="ambiguous", ambiguous=[{"candidates": [[c] for c in candidates]}])


def test_ambiguous_counts_half_with_at_most_three_candidates():
    assert judge(hidden(FRICTION), ambiguous(VISCOUS, NAMED), 3.0).exact == 0.5
    assert judge(hidden(FRICTION), ambiguous(NAMED, VISCOUS, sure=(NAMED,)), 3.0).exact == 0.5
    more = [{"id": "viscous_damping", "at": str(i)} for i in range(3)]
    assert judge(hidden(FRICTION), ambiguous(NAMED, *more), 3.0).exact == 0.0
    assert judge(hidden(FRICTION), ambiguous(VISCOUS, more[0]), 3.0).exact == 0.0


def test_twins_in_principle():
    tilt = {"id": "gravity_tilt", "at": "world", "twins": [["encoder_offset", "root"]], "coin": True}
    offset, alone = {"id": "encoder_offset", "at": "root"}, {"id": "gravity_tilt", "at": "world"}
    assert judge(hidden(tilt), ambiguous(alone, offset), 3.0).exact == 1.0
    assert judge(hidden(tilt), ambiguous(alone, offset, VISCOUS), 3.0).exact == 0.5
    assert judge(hidden(tilt), report(alone), 3.0).exact == 0.5  # a coin toss, though right
    assert judge(hidden(tilt), report(offset), 3.0).exact == 0.5
    assert judge(hidden(tilt), report(offset), 3.0).place
    optional = VISCOUS | {"twins": [["back_emf", "elbow_motor"]]}
    assert judge(hidden(optional), report(VISCOUS), 3.0).exact == 1.0


def test_same_place_under_another_name():
    floor = {"id": "contact_friction", "at": "world", "parameters": {"mu": 0.3}, "same_place": ["floor"]}
    named = {
        "id": "contact_friction",
        "at": "floor",
        "parameters": {"mu": {"value": 0.31, "low": 0.3, "high": 0.32}},
    }
    mark = judge(hidden(floor), report(named), 3.0)
    assert mark.exact == 1.0 and mark.parameters[0].within


def test_two_effects():
    gain = {"id": "actuator_gain", "at": "wrist_motor", "parameters": {"gain": 0.8}}
    answer = hidden(FRICTION, gain, kind="pair")
    assert judge(answer, report(gain, NAMED), 3.0).exact == 1.0
    assert judge(answer, report(NAMED), 3.0).exact == 0.0
    half = report(NAMED, verdict="ambiguous", ambiguous=[{"candidates": [[gain], [VISCOUS]]}])
    assert judge(answer, half, 3.0).exact == 0.5


def test_null_and_unknown():
    nothing = hidden(kind="null")
    assert judge(nothing, report(verdict="none"), 3.0).exact == 1.0
    false_alarm = judge(nothing, report(VISCOUS), 3.0)
    assert false_alarm.alarm and false_alarm.exact == 0.0
    leftover = judge(nothing, report(verdict="unexplained", unexplained={"at": ["elbow"]}), 3.0)
    assert not leftover.alarm and leftover.exact == 0.0
    kick = {"id": "periodic_kick", "at": "elbow"}
    strange = hidden(kind="unknown", unknown=(kick,))
    assert judge(strange, report(verdict="unexplained", unexplained={"at": ["elbow_motor"]}), 3.0).located
    assert not judge(
        strange, report(verdict="unexplained", unexplained={"at": ["hip", "knee", "elbow"]}), 3.0
    ).located
    assert not judge(strange, report(verdict="none"), 3.0).located


def test_failed_run_has_no_marks():
    mark = judge(hidden(FRICTION), None, 900.0)
    assert mark.failed and mark.exact == 0.0 and not mark.place


def test_vectors_count_only_what_can_be_seen():
    truth = {"mass": 0.5, "position": [0.3, 0.0, 0.4]}
    found = {
        "mass": {"value": 0.55, "low": 0.51, "high": 0.6},
        "position": {"value": [0.33, 9.0, 0.4], "low": [0.31, 0, 0.3], "high": [0.4, 0, 0.5]},
    }
    mass, position = compare("payload_mass", truth, found, [0, 2])
    assert mass.error == pytest.approx(0.1) and mass.contained == (False,)
    assert position.error == pytest.approx(0.03 / 0.5) and position.contained == (False, True)
    assert not compare("payload_mass", truth, {}, [0, 2])[0].within


def test_the_same_cogging_and_the_same_tilt_in_other_words():
    truth = {"amplitude": 0.4, "periods": 5.0, "phase": 3.0}
    said = {"amplitude": -0.4, "periods": 5.0, "phase": 3.0 - math.pi}
    found = {k: {"value": v, "low": v - 0.01, "high": v + 0.01} for k, v in said.items()}
    assert all(
        p.error < 1e-9 and p.contained == (True,) for p in compare("cogging_torque", truth, found, [0, 2])
    )
    truth = {"angle": 0.1, "axis": [0.0, 1.0, 0.0]}
    said = {"angle": {"value": -0.1, "low": -0.12, "high": -0.09}, "axis": {"value": [0.0, -2.0, 0.0]}}
    angle, axis = compare("gravity_tilt", truth, said, [0, 2])
    assert angle.error < 1e-6 and angle.contained == (True,) and axis.error < 1e-6


def test_score_files(tmp_path):
    answers, runs = tmp_path / "answers", tmp_path / "runs"
    answers.mkdir()
    for i, (answer, said) in enumerate(
        [(hidden(FRICTION), report(NAMED)), (hidden(FRICTION), report(VISCOUS)), (hidden(kind="null"), None)]
    ):
        name = f"case_{i:03d}"
        (answers / f"{name}.json").write_text(json.dumps(answer | {"case": name}))
        folder = runs / name / "report"
        folder.mkdir(parents=True)
        (runs / name / "run.json").write_text(
            json.dumps({"status": 0 if said else 2, "seconds": 10.0 * (i + 1)})
        )
        if said:
            (folder / "diagnosis.json").write_text(json.dumps(said))
    text = write_score(answers, runs, tmp_path / "score")
    figures = summary(load_marks(answers, runs))
    assert figures["effect and place exactly named"]["value"] == 0.5
    assert figures["right place"]["value"] == 1.0
    within = figures["parameters within 10 %"]
    assert (within["value"], within["of"], within["passed"]) == (1.0, 1, True)
    # by hand: one of one, z = 1.96: (1 + 1.9208) / 4.8416 -+ sqrt(0.9604) 1.96 / 4.8416
    assert within["interval"] == pytest.approx((0.2065, 1.0), abs=1e-4)
    assert figures["seconds a case, worst"]["value"] == 30.0
    assert figures["runs that failed"]["passed"] is False
    assert "viscous_damping@elbow" in text and (tmp_path / "score" / "score.json").exists()
    with pytest.raises(FileNotFoundError):
        load_marks(answers, tmp_path / "nowhere")


def test_times_may_come_from_runs_alone_that_answer_alike(tmp_path):
    answers, runs, alone = (tmp_path / name for name in ("answers", "runs", "alone"))
    answers.mkdir()
    for k in range(2):
        name = f"case_{k:03d}"
        (answers / f"{name}.json").write_text(json.dumps(hidden(FRICTION) | {"case": name}))
        for folder, seconds in ((runs, 300.0 + k), (alone, 150.0)):
            (folder / name / "report").mkdir(parents=True)
            (folder / name / "run.json").write_text(
                json.dumps({"status": 0, "seconds": seconds, "stderr": ""})
            )
            (folder / name / "report" / "diagnosis.json").write_text(json.dumps(report(NAMED)))
    (alone / "case_001" / "run.json").unlink()
    assert [m.seconds for m in load_marks(answers, runs, alone)] == [150.0, 301.0]
    assert "times of 1 of them" in write_score(answers, runs, tmp_path / "score", alone)
    (alone / "case_000" / "report" / "diagnosis.json").write_text(json.dumps(report(VISCOUS)))
    with pytest.raises(ValueError, match="answers otherwise"):
        load_marks(answers, runs, alone)


def test_marks_of_cases_whose_runs_are_gone_count_on(tmp_path):
    answers, runs = (tmp_path / name for name in ("answers", "runs"))
    answers.mkdir()
    plan = answers / "plan.json"
    plan.write_text(json.dumps({"seed": 101, "repeats": 1}))
    for k, said in enumerate((NAMED, VISCOUS, NAMED)):
        name = f"case_{k:03d}"
        (answers / f"{name}.json").write_text(json.dumps(hidden(FRICTION) | {"case": name}))
        (runs / name / "report").mkdir(parents=True)
        (runs / name / "run.json").write_text(json.dumps({"status": 0, "seconds": 10.0 + k, "stderr": ""}))
        (runs / name / "report" / "diagnosis.json").write_text(json.dumps(report(said)))
        (runs / name / "judged.json").write_text(json.dumps([2.0, 1.0 + k]))
    whole = load_marks(answers, runs)
    assert whole[1].wrong and whole[0].parameters and whole[0].judged == (2.0, 1.0)
    for name in ("case_000", "case_002"):
        (runs / name).rename(tmp_path / name)
    write_score(answers, runs, tmp_path / "first")
    kept = tmp_path / "first" / "score.json"
    for name in ("case_000", "case_002"):
        (tmp_path / name).rename(runs / name)
    (runs / "case_001").rename(tmp_path / "gone")
    assert load_marks(answers, runs, kept=kept) == whole and len(load_marks(answers, runs)) == 2
    plan.write_text(json.dumps({"seed": 102, "repeats": 1}))
    with pytest.raises(ValueError, match="another seed or other counts"):
        load_marks(answers, runs, kept=kept)


def test_a_score_takes_its_place_on_a_page(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"# Page\n\n{BEGIN}\nold\n{END}\n\n## After\n")
    for text in ("# Score\n\nfirst\n", "# Score\n\nsecond\n"):
        put_into(page, text)
    assert page.read_text() == f"# Page\n\n{BEGIN}\n\n### Score\n\nsecond\n\n{END}\n\n## After\n"
    page.write_text("# Page\n")
    with pytest.raises(ValueError, match="add both lines"):
        put_into(page, "# Score\n")
    assert page.read_text() == "# Page\n"
