"""The atlas: its page is that of the rows that are kept, and a machine that is kept is not diagnosed again."""

import json
from pathlib import Path

import numpy as np
import pytest

from experiments.atlas import __main__ as command
from experiments.atlas import page, record
from experiments.atlas.machines import MACHINES
from mpge_jax.diagnosis import Config, diagnose

ROOT = Path(__file__).resolve().parents[3]
ROW = {
    "verdict": "unexplained",
    "effects": [["coulomb_friction", "slide"], ["actuator_bias", "rig"]],
    "ambiguous": [
        [
            [["coulomb_friction", "slide"], ["armature", "slide"]],
            [["coulomb_friction", "slide"], ["payload_mass", "slider"], ["joint_stiffness", "slide"]],
        ]
    ],
    "left_at": ["slide"],
    "measure": "force",
    "unit": "N",
    "window_s": 0.005,
    "before": 5000.0,
    "after": 2000.0,
    "median_window": None,
    "noise": 81.0,
    "with_residual": None,
    "each": {"rig": [1.0, 0.4]},
    "seconds": 12,
    "jobs": 2,
    "load_average": 1.5,
    "versions": {"commit": "c0ffee", "machine": "a computer"},
    "source": "owner/name @1234",
    "licence": "MIT",
}


def docs_with(folder: Path, **rows: dict) -> Path:
    for key, row in rows.items():
        file = record.kept(folder, key)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(row))
    return folder


def test_what_functions_reach_stands_beside_what_is_named(tmp_path):
    text = page.markdown(page.rows(docs_with(tmp_path, brfd={**ROW, "with_residual": 1234.5})))
    assert "| 5e+03 N | 2e+03 N; with its functions 1.23e+03 | 2.5 times less |" in text


def test_the_page_is_that_of_the_kept_rows():
    docs = ROOT / "docs"
    written = (docs / "atlas.md").read_text("utf-8")
    assert written == page.text(docs), "python -m experiments.atlas --machine writes it anew"
    for key in page.rows(docs):
        assert (docs / "machines" / f"{key}.md").is_file()


def test_a_row_by_hand(tmp_path):
    text = page.markdown(page.rows(docs_with(tmp_path, brfd=ROW)))
    (line,) = (line for line in text.splitlines() if line.startswith("| [Friction damper"))
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[0] == "[Friction damper with backlash](machines/brfd.md)"
    assert cells[2] == "`unexplained`"
    assert cells[3] == (
        "coulomb friction (slide); actuator bias (rig); armature (slide) or payload mass (slider) with joint stiffness "
        "(slide); something unknown (slide)"
    )
    assert cells[4:7] == ["5e+03 N", "2e+03 N", "2.5 times less"]
    assert cells[7:] == ["0.35 of the force; here 0.4: **missed**", "12 s"]
    assert "Verdicts: 1 `unexplained`. The reference is met on 0 of the 1 that have one." in text
    assert "| Friction damper with backlash | `brfd/standard` | owner/name @1234 | MIT |" in text


def test_what_may_be_a_part_of_the_unknown_is_told_with_it(tmp_path):
    parts = [[["coulomb_friction", "slide"]], [["unexplained", "slide"]]]
    text = page.markdown(page.rows(docs_with(tmp_path, brfd={**ROW, "ambiguous": [parts]})))
    (line,) = (line for line in text.splitlines() if line.startswith("| [Friction damper"))
    assert line.split("|")[4].strip() == (
        "coulomb friction (slide); actuator bias (rig); something unknown (slide), of which coulomb friction (slide) "
        "may be a part"
    )


def test_an_error_that_rises_is_not_said_to_fall(tmp_path):
    worse = {**ROW, "after": 6000.0, "each": {"rig": [0.37, 0.38]}}
    text = page.markdown(page.rows(docs_with(tmp_path, brfd=worse)))
    assert "| 6e+03 N | no less | 0.35 of the force; here 0.38: met |" in text
    assert "met on 1 of the 1" in text


def test_a_fall_that_rounds_to_nothing_is_not_said(tmp_path):
    same = {**ROW, "after": 4900.0}
    assert "| 4.9e+03 N | no less |" in page.markdown(page.rows(docs_with(tmp_path, brfd=same)))


def test_what_learners_leave_is_told_where_it_was_measured(tmp_path):
    motion = {
        "after": 0.02,
        "with_residual": 0.00912,
        "median_window": [0.2, 0.01],
        "each": {"j": [0.2, 0.02]},
    }
    docs = docs_with(tmp_path, brfd=ROW, go2_legs={**ROW, **motion})
    assert "learnt" not in page.text(docs)
    found = {"left": {"rig": 0.904, "other": None, "more": 1.2}, "commit": "abc"}
    learnt = {"brfd": found, "go2_legs": found, "cube_toss": found}
    record.kept(docs, page.LEARNT).write_text(json.dumps(learnt))
    text = page.text(docs)
    assert "| [Friction damper with backlash](machines/brfd.md) | 0.90, 1.20 | - |" in text
    assert "(machines/go2_legs.md) | 0.90, 1.20 | 0.46 |" in text and "commit abc" in text
    assert "(machines/cube_toss.md) | 0.90, 1.20 | - |" in text


def test_references_are_compared_in_their_own_measure():
    motion = {**ROW, "unit": "rad", "after": 0.03, "median_window": [0.2, 0.01], "each": {"j": [0.2, 0.02]}}
    assert page.reached(MACHINES["go2_legs"], motion) == [0.01]
    with pytest.raises(ValueError, match="cube_toss: 1 errors, but a reference of 2"):
        page.reached(MACHINES["cube_toss"], motion)


def test_a_tenth_is_allowed_once(tmp_path):
    """Of forces beside the error of the fit, of motions it is in the reference already."""
    assert MACHINES["brfd"].reference.enough == pytest.approx((0.385,))
    assert MACHINES["go2_legs"].reference.enough == (0.011,)
    motion = {**ROW, "unit": "rad", "median_window": [0.2, 0.0112]}
    text = page.text(docs_with(tmp_path, go2_legs=motion))
    assert (
        "| 0.011 rad in the usual window; here 0.0112: **missed** |" in text and "met on 0 of the 1" in text
    )


def test_only_machines_without_a_row_are_diagnosed(tmp_path, monkeypatch):
    docs = docs_with(tmp_path, **{key: ROW for key in MACHINES if key not in ("brfd", "go2_legs")})
    done = []
    monkeypatch.setattr(record, "diagnosed", lambda machine, *_: done.append(machine.key) or "a diagnosis")
    monkeypatch.setattr(record, "keep", lambda d, machine, *_: docs_with(docs, **{machine.key: ROW}))
    command.run(command.Args(recordings=tmp_path, docs=docs))
    command.run(command.Args(recordings=tmp_path, docs=docs))
    assert done == ["brfd", "go2_legs"]
    command.run(command.Args(recordings=tmp_path, docs=docs, machine=("brfd",)))
    assert done == ["brfd", "go2_legs", "brfd"]


def test_what_cannot_be_done_is_one_sentence(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv(record.FOLDER, raising=False)
    for given, said in (
        (["--machine", "r2d2"], "--machine r2d2 is not known"),
        (["--machine", "brfd"], "brfd: no result yet, and --recordings is no folder"),
        (["--machine"], "no machine was diagnosed yet"),
    ):
        monkeypatch.setattr("sys.argv", ["atlas", *given, "--docs", str(tmp_path)])
        assert command.main() == 2
        assert capsys.readouterr().err.startswith(f"atlas: {said}")


def test_sources_and_licences_are_read_from_a_readme(tmp_path):
    readme = tmp_path / "README.txt"
    readme.write_text(
        "A rig.\nSource repo : owner/name @1234, data/set-3 (tests)\nLicense     : BSD 3-Clause (file)\n"
    )
    assert record.source(readme) == {"source": "owner/name @1234", "licence": "BSD 3-Clause"}
    readme.write_text("A rig.\n")
    with pytest.raises(ValueError, match="no line that says its source"):
        record.source(readme)


def test_errors_of_a_motion_are_medians_of_windows(tmp_path):
    model = """<mujoco><worldbody><body name="cube" pos="0 0 1"><freejoint name="free"/>
      <geom type="box" size=".1 .1 .1" mass="1"/></body></worldbody></mujoco>"""
    (tmp_path / "model.xml").write_text(model)
    rng = np.random.default_rng(0)
    time = np.arange(0, 2.0, 0.01)
    for number in range(3):
        qpos = np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(time), 1))
        # Falls with 0.8 of the model's gravity.
        qpos[:, 2] = 30 - 0.5 * 0.8 * 9.81 * time**2
        qpos[:, :3] += 1e-4 * rng.standard_normal((len(time), 3))
        name = "heldout_0" if number == 0 else f"run_{number}"
        np.savez(tmp_path / f"{name}.npz", time=time, qpos=qpos, ctrl=np.zeros((len(time), 0)))
    d = diagnose(tmp_path / "model.xml", tmp_path, Config(jobs=1, effects=("gravity_tilt",), quiet=True))
    found = record.facts(d)
    assert list(found["each"]) == ["free, position", "free, rotation"]
    before, _ = found["each"]["free, position"]
    # 0.5 s of free fall that is 1.96 m/s^2 off: 0.245 m at the end, and 0.245 / sqrt(5) root mean square.
    assert before == pytest.approx(0.245 / np.sqrt(5), rel=0.15)
    assert (found["measure"], found["unit"]) == ("motion", "rad and m")
    assert found["before"] < before
