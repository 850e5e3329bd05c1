"""Machines that reports describe, on recordings that they were not made from."""

import json

import mujoco
import numpy as np

from mpge_jax.diagnosis.corrected import replay
from mpge_jax.diagnosis.corrected.corrected_model import CorrectedModel

CART = """<mujoco><option timestep="0.01" gravity="0 0 0"/>
<worldbody><body><joint name="rail" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body></worldbody>
<actuator><motor name="push" joint="rail"/></actuator></mujoco>"""
LATE = {"id": "actuator_delay", "at": "push", "parameters": {"delay": 0.03}}


def test_commands_before_the_start_act_after_it():
    """1 kg, 3 steps late: under a force of 1 N the speed grows by 0.01 m/s a step from the first or the fourth on."""
    stepper = CorrectedModel.build(mujoco.MjSpec.from_string(CART), [LATE]).c_stepper()
    speeds = {}
    for name, before in (("pushed", np.ones((5, 1))), ("left", np.zeros((5, 1)))):
        stepper.reset(np.zeros(1), np.zeros(1), before)
        speeds[name] = []
        for _ in range(5):
            stepper.step(np.ones(1))
            speeds[name].append(float(stepper.data.qvel[0]))
    np.testing.assert_allclose(speeds["pushed"], [0.01, 0.02, 0.03, 0.04, 0.05], atol=1e-12)
    np.testing.assert_allclose(speeds["left"], [0, 0, 0, 0.01, 0.02], atol=1e-12)


def test_each_case_is_judged_once_by_its_own_recordings(tmp_path):
    report = tmp_path / "runs" / "case_0" / "report"
    report.mkdir(parents=True)
    (report / "nominal.xml").write_text(CART)
    (report / "effects.json").write_text(json.dumps({"model": "nominal.xml", "effects": [LATE]}))
    (tmp_path / "runs" / "case_1" / "report").mkdir(parents=True)  # ended without a machine
    machine = CorrectedModel.from_folder(report).c_stepper()
    rng = np.random.default_rng(0)
    machine.reset(np.zeros(1), np.zeros(1))
    rows: dict[str, list] = {"time": [], "qpos": [], "qvel": [], "ctrl": []}
    for _ in range(200):
        ctrl = rng.standard_normal(1)
        for name, value in (
            ("time", machine.data.time),
            ("qpos", machine.data.qpos.copy()),
            ("qvel", machine.data.qvel.copy()),
            ("ctrl", ctrl),
        ):
            rows[name].append(value)
        machine.step(ctrl)
    answers = tmp_path / "answers"
    answers.mkdir()
    np.savez(answers / "case_0_judge_0.npz", **{name: np.array(values) for name, values in rows.items()})
    replay.main(tmp_path / "runs", answers)
    before, after = json.loads((tmp_path / "runs" / "case_0" / "judged.json").read_text())
    assert before > 1e-3 and after < 1e-9
    assert not (tmp_path / "runs" / "case_1" / "judged.json").exists()
    (tmp_path / "runs" / "case_0" / "judged.json").write_text("[2.0, 1.0]")
    replay.main(tmp_path / "runs", answers)
    assert (tmp_path / "runs" / "case_0" / "judged.json").read_text() == "[2.0, 1.0]"
