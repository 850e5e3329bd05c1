"""The demonstration: what is concealed is there, what is measured is the hand's, and the page stands by itself."""

import json
import re

import mujoco
import numpy as np
import pytest

from experiments.demo import __main__ as demo
from experiments.demo import arm, policy
from experiments.demo.page import page
from experiments.demo.simulated import Simulated

SEEDS = {"joint_stiffness": 0, "actuator_gain": 1, "payload_mass": 11}


def test_each_seed_conceals_what_it_says_and_nothing_else():
    given = arm.simulator().model
    for effect, seed in SEEDS.items():
        hidden = arm.concealed(seed)
        assert hidden.id == effect and hidden == arm.concealed(seed)
        model = arm.target(hidden).model
        changed = {
            "joint_stiffness": model.jnt_stiffness[1] - given.jnt_stiffness[1],
            "actuator_gain": model.actuator_gainprm[0, 0] / given.actuator_gainprm[0, 0],
            "payload_mass": model.body_mass[2] - given.body_mass[2],
        }
        nothing = {"joint_stiffness": 0.0, "actuator_gain": 1.0, "payload_mass": 0.0}
        assert changed == pytest.approx(nothing | {effect: hidden.value})
    assert {arm.concealed(s).id for s in range(12)} == set(SEEDS)


def test_the_reward_is_that_of_the_hand():
    model = arm.simulator().model
    data = mujoco.MjData(model)
    for q in np.random.default_rng(0).uniform(-3, 3, (5, 2)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        x, _, z = data.site("hand").xpos
        expected = np.hypot(x - arm.GOAL[0], z - arm.GOAL[1])
        assert float(arm._distance(q)) == pytest.approx(expected, abs=1e-5)


def test_recordings_are_the_targets_motion_with_noise():
    hidden = arm.concealed(11)
    runs = arm.recordings(hidden, 11)
    assert [r.name for r in runs] == ["run_0", "run_1", "run_2", "run_3", "heldout_4", "heldout_5"]
    model = arm.target(hidden).model
    data = mujoco.MjData(model)
    data.qpos[:] = runs[0].qpos[0]
    for k in range(30):
        assert np.abs(data.qpos - runs[0].qpos[k]).max() < 0.02
        data.ctrl[:] = runs[0].ctrl[k]
        mujoco.mj_step(model, data, 2)
    assert np.ptp(runs[0].qpos[:30, 0]) > 0.1


def _table(verdict, effects):
    held = {"before": 14.1, "after": 1.22, "noise_floor": 0.1, "recordings": ["<b>"], "per_joint": {}}
    fit = {"unit": "N m", "held_out": held}
    return {"verdict": verdict, "effects": effects, "explanation": "A load of <b>.", "fit": fit}


def _effect(hidden):
    size = {"value": hidden.value, "low": hidden.value - 0.01, "high": hidden.value + 0.01, "unit": "kg"}
    return {"id": hidden.id, "at": hidden.at, "parameters": {hidden.parameter: size}, "error_drop": 0.9}


@pytest.mark.parametrize("found", [True, False])
def test_the_page_stands_by_itself_and_says_whether_it_was_found(found, tmp_path):
    hidden = arm.concealed(11)
    effects = [_effect(hidden)] if found else []
    for folder in ("arm", "machine"):
        (tmp_path / folder / "figures").mkdir(parents=True)
        for name in ("robot", "whole"):
            (tmp_path / folder / "figures" / f"{name}.png").write_bytes(b"\x89PNG")
    (tmp_path / "arm" / "figures" / "strip.png").write_bytes(b"\x89PNG")
    (tmp_path / "machine" / "diagnosis.json").write_text(json.dumps(_table("ambiguous", [_effect(hidden)])))
    returns = {name: {"target": [40.0, 50.0], "curve": [None, 1.0]} for name in ("as given", "corrected")}
    text = page(
        Simulated(hidden, _table("effects" if found else "none", effects), returns),
        tmp_path,
        demo.MACHINE,
        90.0,
    )
    assert ("The diagnosis found it: 0.85" in text) is found
    assert ("did not name it; its verdict is none" in text) is not found
    assert "45.0 ± 5.0" in text and "11.6 times less" in text and "in 1.5 minutes" in text
    assert "<b>." not in text and text.count("data:image/png") == 6
    assert not re.search(r"(?:src|href)=['\"]https?:", text)


def test_a_folder_of_another_seed_is_refused(tmp_path, capsys):
    (tmp_path / "seed.txt").write_text("3\n")
    assert demo.main(["--out", str(tmp_path), "--seed", "4", "--no-open"]) == 2
    assert "holds the demonstration of seed 3; give another --out" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["seed.txt"]


def test_the_real_log_comes_with_its_licence_and_source():
    assert "BSD 3-Clause" in (demo.MACHINE / "LICENSE").read_text()
    assert "unisa-acg/inverse-dynamics-solver" in (demo.MACHINE / "SOURCE.md").read_text()
    assert sum(p.stat().st_size for p in demo.MACHINE.iterdir()) < 300_000


@pytest.mark.slow
def test_everything_is_done_once_and_read_the_second_time(tmp_path, monkeypatch):
    monkeypatch.setattr(policy, "ITERATIONS", 2)
    args = demo.Args(tmp_path / "out", seed=SEEDS["payload_mass"], open=False, quiet=True)
    first = demo.demo(args).read_text()
    assert "The diagnosis found it: 0.85" in first
    monkeypatch.setattr(policy, "train", lambda *_: pytest.fail("trained again"))
    monkeypatch.setattr(demo, "_diagnosing", lambda *_: pytest.fail("diagnosed again"))
    assert demo.demo(args).read_text().partition("</h1>")[2] == first.partition("</h1>")[2]
