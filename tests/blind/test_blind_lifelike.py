"""What real logs have: machines at random, models that are off, sizes as drawn, and how such cases are marked."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from experiments.blind.build import build_case
from experiments.blind.circumstances import Circumstances, draw_circumstances
from experiments.blind.robots.models import ROBOTS
from experiments.blind.robots.trees import random_tree
from experiments.blind.scoring.figures import by_size, summary, wilson
from experiments.blind.scoring.marks import judge
from experiments.blind.truth.machine import Machine
from experiments.blind.truth.physics import UNKNOWN
from experiments.blind.vocabulary import PARAMETERS, Effect
from experiments.blind.wishes import Counts, Wish, draw_machine, fits, wishes
from mpge_jax.diagnosis.corrected.replay import errors_of


@pytest.mark.parametrize("joints", range(1, 8))
def test_a_random_tree_is_a_machine(joints):
    rng = np.random.default_rng(joints)
    robot = random_tree(rng, joints)
    model = mujoco.MjModel.from_xml_string(robot.spec().to_xml())
    assert model.njnt == model.nu == len(robot.references) == joints
    for effect, places in robot.places.items():
        assert effect in PARAMETERS or effect in UNKNOWN
        for at in places:
            found = [mujoco.mj_name2id(model, kind, at) for kind in (1, 3, 19)]
            assert at == "world" or max(found) >= 0, (effect, at)
    # the motors can hold it stretched out in any pose
    data = mujoco.MjData(model)
    for _ in range(20):
        data.qpos[:] = rng.uniform(-np.pi, np.pi, joints)
        mujoco.mj_forward(model, data)
        assert (np.abs(data.qfrc_bias) < model.actuator_gear[:, 0] * model.actuator_ctrlrange[:, 1]).all()


def test_random_trees_differ_and_have_1_to_7_joints():
    drawn = [random_tree(np.random.default_rng(seed)) for seed in range(40)]
    assert len({robot.xml for robot in drawn}) == 40
    assert {len(robot.references) for robot in drawn} == set(range(1, 8))
    assert random_tree(np.random.default_rng(3)).xml == drawn[3].xml
    with pytest.raises(ValueError, match="1 to 7 joints, not 8"):
        random_tree(np.random.default_rng(0), 8)


def test_masses_of_the_given_model_are_off_and_nothing_else_is():
    spec = ROBOTS["twolink"].spec()
    true = spec.compile()
    given = mujoco.MjModel.from_xml_string(Circumstances(masses=0.03).given(spec, np.random.default_rng(0)))
    ratio = given.body_mass[1:] / true.body_mass[1:]
    assert (np.abs(ratio - 1) < 0.15).all() and (np.abs(ratio - 1) > 1e-4).all() and len(set(ratio)) > 1
    np.testing.assert_allclose(given.body_ipos, true.body_ipos, atol=1e-6)
    assert (given.dof_armature == true.dof_armature).all()
    same = mujoco.MjModel.from_xml_string(
        Circumstances().given(ROBOTS["twolink"].spec(), np.random.default_rng(0))
    )
    np.testing.assert_allclose(same.body_inertia, true.body_inertia, rtol=1e-6)


def test_logs_with_outliers_and_late_commands():
    rng = np.random.default_rng(0)
    columns = {"qpos": np.zeros((4000, 2)), "ctrl": np.arange(4000.0)[:, None]}
    logged = Circumstances(outliers=0.002, late_rows=1).logged(columns, rng)
    wrong = logged["qpos"] != 0
    assert 4 < wrong.sum() < 35 and (np.abs(logged["qpos"][wrong]) >= 0.05).all()
    assert logged["ctrl"][:4, 0].tolist() == [0, 0, 1, 2]
    assert columns["qpos"].any() == False and columns["ctrl"][1] == 1  # noqa: E712
    friction = Effect("coulomb_friction", "elbow", {"torque": 1.0})
    assert Circumstances(law="creeping").ways() == []
    assert Circumstances(law="creeping").ways([friction]) == ["dry friction creeping"]
    assert Circumstances(period=1 / 30, masses=0.03).ways() == ["masses and inertias off", "rows of 30 Hz"]


def test_commands_by_a_clock_that_drifts_apart():
    time = 5.0 + np.arange(3000) * 0.01
    columns = {"time": time, "qpos": np.zeros((3000, 1)), "ctrl": np.arange(3000.0)[:, None]}
    logged = Circumstances(clock=0.0095).logged(columns, np.random.default_rng(0))["ctrl"][:, 0]
    # a row late, and once 2.5 s have passed two rows
    assert logged[:3].tolist() == [0, 0, 1] and logged[1000] == 998
    assert np.flatnonzero(np.diff(logged[1:]) == 0).tolist() == [249]
    assert Circumstances(clock=0.0095).ways() == ["commands by another clock"]


def test_circumstances_suit_the_machine(tmp_path):
    rng, seen = np.random.default_rng(0), set()
    for name in ("quad", "crane", "servo_arm", "pendulum"):
        (tmp_path / "model.xml").write_text(ROBOTS[name].spec().to_xml())
        machine: Machine = draw_machine(ROBOTS[name], Wish("null"), tmp_path / "model.xml", rng)
        for _ in range(60):
            drawn = draw_circumstances(rng, machine)
            seen |= {way.split()[0] for way in drawn.ways()}
            assert not (name == "quad" and drawn.outliers) and not (name == "crane" and drawn.period)
            assert not (name == "pendulum" and drawn.late_rows)
            assert not draw_circumstances(rng, machine, off=False).masses
    assert seen == {"masses", "outliers", "commands", "rows"}


def test_wishes_of_mixed_and_whole_machines():
    drawn = wishes(np.random.default_rng(0), Counts(0, 0, 0, 0, 0, mixed=9, whole=3, lifelike=True))
    assert sorted(w.kind for w in drawn) == ["mixed"] * 9 + ["whole"] * 3
    mixed = [w.effects for w in drawn if w.kind == "mixed"]
    assert all(known in PARAMETERS and strange in UNKNOWN for known, strange in mixed)
    assert {strange for _, strange in mixed} == set(UNKNOWN)
    assert fits(ROBOTS["geared_arm"], Wish("whole")) and not fits(ROBOTS["quad"], Wish("whole"))
    assert not fits(ROBOTS["pendulum"], Wish("whole"))  # it takes no payload


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A machine of which every joint lacks something, its answer and the recordings that only judge it."""
    folder = tmp_path_factory.mktemp("whole")
    quick = replace(ROBOTS["twolink"], steps=((0.001, "Euler"),), duration=(1.5, 2.0), periods=(0.01,))
    answer, judging = build_case(Wish("whole"), folder, [5, 1], {}, (quick,), lifelike=False)
    return folder, answer, judging


def test_every_joint_lacks_something(whole):
    _, answer, judging = whole
    hidden = [(e["id"], e["at"]) for e in answer["effects"]]
    assert {("armature", "shoulder"), ("armature", "elbow"), ("payload_mass", "fore")} <= set(hidden)
    assert {at for name, at in hidden if name in ("coulomb_friction", "viscous_damping")} == {
        "shoulder",
        "elbow",
    }
    assert set(judging) == {"judge_0", "judge_1"}


def test_the_scorer_predicts_its_own_recordings_by_the_reported_machine(whole, tmp_path):
    folder, answer, judging = whole
    files = []
    for name, run in judging.items():
        files.append(tmp_path / f"{name}.npz")
        np.savez(files[-1], time=run.time, qpos=run.qpos, qvel=run.qvel, ctrl=run.ctrl)
    (tmp_path / "nominal.xml").write_text((folder / "model.xml").read_text())

    def report(effects: list[dict]) -> None:
        entries = [{k: e[k] for k in ("id", "at", "parameters")} for e in effects]
        (tmp_path / "effects.json").write_text(json.dumps({"model": "nominal.xml", "effects": entries}))

    report([])
    before, after = errors_of(tmp_path, files)
    assert before == after > 0.01
    report(answer["effects"])
    true = errors_of(tmp_path, files)
    assert true[0] == before and true[1] < before / 20
    report(answer["effects"][1:])
    assert errors_of(tmp_path, files)[1] > 3 * true[1]


FRICTION = {"id": "coulomb_friction", "at": "elbow", "parameters": {"torque": 0.7}}
INERTIA = {"id": "armature", "at": "wrist", "parameters": {"inertia": 0.1}}
KICK = {"id": "periodic_kick", "at": "elbow"}


def hidden(*effects: dict, kind: str, unknown: tuple[dict, ...] = (), **more) -> dict:
    filled = [{"twins": [], "coin": False, "same_place": [], **e} for e in effects]
    places = {e["at"]: [e["at"]] for e in [*effects, *unknown]}
    base = {"case": "case_000", "kind": kind, "model": "arm", "plane": [0, 2], "concealed": []}
    return base | {"effects": filled, "unknown": list(unknown), "places": places} | more


def said(*effects: dict, verdict: str = "effects", at: str = "", ambiguous: tuple = ()) -> dict:
    groups = [{"candidates": [[c] for c in ambiguous]}] if ambiguous else []
    left = {"at": [at]} if at else None
    return {"verdict": verdict, "effects": list(effects), "ambiguous": groups, "unexplained": left}


def test_beside_unknown_physics_the_known_part_counts():
    answer = hidden(FRICTION, kind="mixed", unknown=(KICK,))
    full = judge(answer, said(FRICTION, verdict="unexplained", at="elbow"), 1.0)
    assert (full.exact, full.located, full.wrong) == (1.0, True, [])
    open_ = judge(answer, said(verdict="unexplained", at="elbow", ambiguous=(FRICTION, INERTIA)), 1.0)
    assert open_.exact == 0.5
    more = judge(answer, said(FRICTION, INERTIA, verdict="unexplained", at="elbow"), 1.0)
    assert more.exact == 0.0 and more.wrong == [("armature", "wrist")]
    assert judge(answer, said(verdict="unexplained", at="elbow"), 1.0).exact == 0.0
    # what may be a part of the unknown is no wrong name, and only half of a right one
    unknown = {"id": "unexplained", "at": "elbow", "parameters": {}}
    doubted = said(FRICTION, verdict="unexplained", at="elbow", ambiguous=(FRICTION, unknown))
    assert judge(answer, doubted, 1.0).exact == 0.5
    nothing_else = judge(hidden(kind="unknown", unknown=(KICK,)), doubted, 1.0)
    assert (nothing_else.exact, nothing_else.wrong) == (1.0, [])


def test_a_share_of_what_every_joint_lacks():
    answer = hidden(FRICTION, INERTIA, kind="whole")
    assert judge(answer, said(FRICTION, INERTIA), 1.0).exact == 1.0
    assert judge(answer, said(FRICTION), 1.0).exact == 0.5
    twin = hidden(FRICTION | {"twins": [["actuator_deadzone", "motor"]]}, INERTIA, kind="whole")
    alike = said(
        INERTIA, verdict="ambiguous", ambiguous=(FRICTION, {"id": "actuator_deadzone", "at": "motor"})
    )
    assert judge(twin, alike, 1.0).exact == 1.0
    assert judge(answer, alike, 1.0).exact == 0.75
    wrong = {"id": "backlash", "at": "elbow"}
    assert judge(answer, said(FRICTION, wrong), 1.0).exact == 0.0


def test_wrong_names_are_those_named_for_certain():
    answer = hidden(FRICTION, kind="single")
    assert judge(answer, said(INERTIA), 1.0).wrong == [("armature", "wrist")]
    assert judge(answer, said(INERTIA, verdict="ambiguous", ambiguous=(INERTIA, FRICTION)), 1.0).wrong == []
    # what all candidates have in common is named for certain
    common = said(INERTIA, verdict="ambiguous")
    common["ambiguous"] = [{"candidates": [[INERTIA, FRICTION], [INERTIA, KICK]]}]
    assert judge(answer, common, 1.0).wrong == [("armature", "wrist")]
    off = hidden(FRICTION, kind="single", concealed=["masses and inertias off"])
    assert judge(off, said(FRICTION, INERTIA), 1.0).wrong == []
    assert judge(off, said({"id": "backlash", "at": "elbow"}), 1.0).wrong == [("backlash", "elbow")]


def test_what_stands_for_masses_that_are_off_is_no_second_answer():
    off = hidden(FRICTION, kind="single", concealed=["masses and inertias off"])
    scale = {"id": "mass_scale", "at": "world", "parameters": {"factor": 1.1}}
    masses = (scale, {"id": "com_offset", "at": "fore"})
    open_ = said(FRICTION, masses[0], verdict="ambiguous", ambiguous=masses)
    assert judge(off, open_, 1.0).exact == 1.0
    assert judge(hidden(FRICTION, kind="single"), open_, 1.0).exact == 0.0


def test_what_is_hidden_below_the_noise_is_told_apart():
    small = judge(hidden(FRICTION, kind="single", visibility={"a": 5.0}), said(verdict="none"), 1.0)
    large = judge(hidden(FRICTION, kind="single", visibility={"a": 60.0, "b": 13.0}), said(FRICTION), 1.0)
    assert not small.visible and large.visible and large.seen == 13.0
    assert summary([small, large])["effect and place exactly named"]["of"] == 1
    rows = by_size([small, large])
    assert [row["single"] for row in rows] == [0, 1, 1, 0, 0]
    assert (rows[1]["exact"], rows[1]["none"], rows[2]["exact"]) == (0.0, 1.0, 1.0)


def test_wilson_interval_by_hand():
    # 8 of 10 (Wilson 1927): 0.490 to 0.943
    assert wilson(0.8, 10) == pytest.approx((0.4901, 0.9433), abs=1e-4)
    assert wilson(0.0, 0) == (0.0, 1.0)
