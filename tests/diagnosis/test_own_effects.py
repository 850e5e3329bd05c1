"""Effects of a user's own, from a file."""

from __future__ import annotations

import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from experiments.diagnose import main
from mpge_jax import own_code
from mpge_jax.diagnosis import REGISTRY, InputError, load_effects, own_effects
from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.selection.checkpoint import fingerprint
from tests.diagnosis.machines import PENDULUM, record
from tests.diagnosis.searches import prepared_of

DOCUMENTATION = (Path(__file__).parents[2] / "docs" / "diagnosis.md").read_text()
(MAGNET,) = re.findall(r"```python\n(from[^`]*class Magnet.*?)```", DOCUMENTATION, re.DOTALL)


@pytest.fixture
def registry(monkeypatch):
    """Registrations end with the test."""
    before = dict(REGISTRY)
    monkeypatch.setattr(own_effects, "_read", {})
    monkeypatch.setattr(own_code, "_loaded", {})
    yield REGISTRY
    REGISTRY.clear()
    REGISTRY.update(before)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "does not exist; give the path of a Python file."),
        ("x = 1", "registers no effect; put @register (from mpge_jax.diagnosis) above a class of Effect."),
        (MAGNET.replace('"magnet"', '"armature"'), "an effect named 'armature' exists already."),
        (MAGNET + "\n\n1 / 0\n", "cannot be used: ZeroDivisionError in line"),
        (
            "from mpge_jax.diagnosis import register\nfrom mpge_jax.diagnosis.effects.native import *\n"
            "from mpge_jax.diagnosis.effects.friction.dry import CoulombFriction as Known\n"
            "class CoulombFriction(Known):\n    pass\n\n\nregister(CoulombFriction)\n",
            "registers 'coulomb_friction', which exists already; give the effect another id.",
        ),
    ],
)
def test_a_file_that_cannot_be_used_is_one_sentence_and_changes_nothing(registry, tmp_path, text, message):
    path, before = tmp_path / "mine.py", dict(registry)
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError) as error:
        load_effects(path)
    said = str(error.value)
    assert said.startswith(str(path)) and message in said and said.endswith(".") and "\n" not in said
    assert registry == before


def test_a_search_does_not_go_on_with_other_effects(registry, tmp_path):
    p = prepared_of(PENDULUM, record(PENDULUM, 1.0))
    plain = fingerprint(p)
    (tmp_path / "magnet.py").write_text(MAGNET)
    assert load_effects(tmp_path / "magnet.py") == load_effects(tmp_path / "magnet.py") == ("magnet",)
    first = fingerprint(p)
    (tmp_path / "other.py").write_text(MAGNET.replace("magnet", "bar").replace("2 *", "3 *"))
    load_effects(tmp_path / "other.py")
    assert len({plain, first, fingerprint(p)}) == 3


def test_the_command_finds_an_effect_of_ones_own(registry, tmp_path, capsys):
    """The magnet of the documentation, hidden in a pendulum: named, written and rebuilt."""

    def magnet(_model, data):
        data.qfrc_applied[0] -= 0.25 * np.sin(2 * data.qpos[0])

    (tmp_path / "model.xml").write_text(PENDULUM)
    (tmp_path / "magnet.py").write_text(MAGNET)
    for r in record(PENDULUM, 1.2, force=magnet):
        np.savez(tmp_path / f"{r.name}.npz", time=r.time, qpos=r.qpos, ctrl=r.ctrl)
    out = tmp_path / "out"
    arguments = ["--model", tmp_path / "model.xml", "--recordings", tmp_path, "--out", out, "--jobs", 1]
    arguments += [
        "--effects",
        "magnet",
        "viscous_damping",
        "--quiet",
        "--effects-file",
        tmp_path / "magnet.py",
    ]
    assert main(list(map(str, arguments))) == 0
    table = json.loads((out / "effects.json").read_text())
    (row,) = table["effects"]
    assert (row["id"], row["file"]) == ("magnet", str(tmp_path / "magnet.py"))
    assert row["parameters"]["strength"] == pytest.approx(0.25, rel=0.05)
    assert "magnet" in capsys.readouterr().out
    stepper = CorrectedModel.from_folder(out).c_stepper()
    stepper.reset(np.array([0.8]), np.zeros(1))
    stepper.step(np.zeros(1), 100)
    data = mujoco.MjData(model := mujoco.MjModel.from_xml_string(PENDULUM))
    data.qpos[:] = 0.8
    for _ in range(100):
        data.qfrc_applied[:] = -row["parameters"]["strength"] * np.sin(2 * data.qpos)
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(stepper.data.qpos, data.qpos, atol=1e-6)
    # Another process must be told the file.
    del registry["magnet"]
    with pytest.raises(InputError, match=r"magnet is an effect of .*magnet\.py; load it first"):
        CorrectedModel.from_folder(out)
