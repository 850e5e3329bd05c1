"""The command end to end on a pendulum: verdict, files, exit statuses, and the report in a browser."""

from __future__ import annotations

import base64
import contextlib
import html
import importlib.util
import io
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import yaml

import envs
from experiments.diagnose import main
from mpge_jax import files
from mpge_jax.diagnosis import VOCABULARY, Config, InputError, Recording, diagnose
from mpge_jax.diagnosis.corrected import CorrectedModel
from mpge_jax.diagnosis.corrected.mjcf import write_models
from mpge_jax.diagnosis.estimation.estimate import NOTHING
from mpge_jax.diagnosis.machine.model import load_spec
from mpge_jax.diagnosis.report import folder as report_folder
from mpge_jax.diagnosis.report import tables
from mpge_jax.diagnosis.selection.setup import build_search
from tests.diagnosis.machines import FINE_PENDULUM, PENDULUM, record

ROOT = Path(__file__).parents[2]
EFFECTS = ["coulomb_friction", "viscous_damping", "actuator_gain"]
MODEL = "model<i>.xml"
EVIL = 'hinge&lt;script&gt;alert(1)&lt;/script&gt;"'


def _friction(model, data):
    data.qfrc_applied[0] -= 0.1 * np.tanh(data.qvel[0] / 0.03)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Model and recordings with hostile names, of a pendulum whose joint has one too and dry friction of 0.1 N m."""
    path = tmp_path_factory.mktemp("pendulum")
    (path / MODEL).write_text(PENDULUM.replace('"hinge"', f"'{EVIL}'"))
    for r in record(PENDULUM, 1.2, force=_friction):
        np.savez(path / f"{r.name}<img src=x>.npz", time=r.time, qpos=r.qpos, ctrl=r.ctrl)
    return path


@pytest.fixture(scope="module")
def result(folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    arguments = ["--model", str(folder / MODEL), "--recordings", str(folder), "--out", str(out)]
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert main([*arguments, "--effects", *EFFECTS, "--jobs", "1", "--quiet", "--json"]) == 0
    written = json.loads((out / "diagnosis.json").read_text())
    assert json.loads(said.getvalue()) == written
    return out, written


def test_the_vocabulary_is_listed_as_it_is_documented(capsys):
    with pytest.raises(SystemExit) as done:
        main(["--list-effects"])
    table = capsys.readouterr().out
    assert done.value.code == 0 and table.count("\n") == 2 + len(VOCABULARY)
    assert table in (ROOT / "docs" / "vocabulary.md").read_text(), "copy the output of --list-effects there"


def test_friction_is_named_with_its_value(result):
    _, table = result
    assert table["schema"] == 1 and table["verdict"] == "effects"
    (effect,) = table["effects"]
    assert effect["id"] == "coulomb_friction" and "script" in effect["at"]
    torque = effect["parameters"]["torque"]
    assert torque["value"] == pytest.approx(0.1, rel=0.05) and torque["unit"] == "N m"
    assert torque["low"] < torque["value"] < torque["high"]
    assert effect["error_drop"] > 0.9
    assert " rad, " in table["explanation"]
    held = table["fit"]["held_out"]
    assert held["before"] > 5 * held["after"] and table["fit"]["window_s"] == pytest.approx(0.5, rel=0.05)
    assert set(table) == {
        "schema", "verdict", "effects", "ambiguous", "unexplained", "location", "fit", "explanation",
        "warnings", "seed", "versions", "residual", "given_inertias",
    }  # fmt: skip


def test_corrected_files_rebuild_the_machine(result, folder):
    out, table = result
    model = mujoco.MjModel.from_xml_path(str(out / "corrected.xml"))
    value = table["effects"][0]["parameters"]["torque"]["value"]
    assert model.dof_frictionloss[0] == pytest.approx(value, rel=1e-4)
    rebuilt = CorrectedModel.load(folder / MODEL, out / "effects.json").c_stepper()
    rebuilt.reset(np.array([0.8]), np.zeros(1))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.8
    for _ in range(100):
        rebuilt.step(np.array([0.3]))
        data.ctrl[:] = 0.3
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(rebuilt.data.qpos, data.qpos, atol=1e-5)


def test_the_users_own_file_is_patched(result):
    out, table = result
    value = table["effects"][0]["parameters"]["torque"]["value"]
    ((_, joint),) = yaml.safe_load((out / "corrected.yaml").read_text())["joints"].items()
    assert joint["frictionloss"] == {"given": 0.0, "corrected": pytest.approx(value, rel=1e-4), "unit": "N m"}
    added = [line for line in (out / "corrected.patch").read_text().splitlines() if line.startswith("+<")]
    assert added and all("frictionloss=" in line for line in added)


def test_the_environment_file_runs_as_the_corrected_machine(result):
    out, table = result
    name = f"corrected_env_{out.name}"
    module = importlib.util.module_from_spec(
        importlib.util.spec_from_file_location(name, out / "corrected_env.py")
    )
    module.__loader__.exec_module(module)
    env = module.env("c")
    friction = env.model.dof_frictionloss[0]
    assert friction == pytest.approx(table["effects"][0]["parameters"]["torque"]["value"], rel=1e-4)
    # Held by friction, which the machine as it was given does not have.
    start = np.array([0.9 * friction], np.float32)
    assert env.action_low[0] < start[0] < env.action_high[0]
    state = env.state_from_obs(jnp.array([0.0, 0.0]))
    moved = float(jax.jit(env.step)(state, jnp.asarray(start)).obs[0])
    given = envs.Env(module.TASK, plain := envs.build_model(module.TASK), envs.engine_of(plain, "c"))
    freely = float(
        jax.jit(given.step)(given.state_from_obs(jnp.array([0.0, 0.0])), jnp.asarray(start)).obs[0]
    )
    assert freely > 1e-4 and abs(moved) < 0.2 * freely
    for bridged in (module.brax("c"), *([module.playground("c")] if find_spec("mujoco_playground") else [])):
        first = bridged.reset(jax.random.key(0))
        assert bridged.step(first, jnp.asarray(start)).obs.shape == (2,)


def test_effects_file_names_the_model_to_which_its_effects_are_to_be_added(result, folder):
    out, _ = result
    named = json.loads((out / "effects.json").read_text())["model"]
    steppers = [
        CorrectedModel.from_folder(out).c_stepper(),
        CorrectedModel.load(out / named, out / "effects.json").c_stepper(),
        CorrectedModel.load(folder / MODEL, out / "effects.json").c_stepper(),
    ]
    model = mujoco.MjModel.from_xml_path(str(out / "corrected.xml"))
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = 0.8, 0.3
    mujoco.mj_step(model, data, 100)
    for stepper in steppers:
        stepper.reset(np.array([0.8]), np.zeros(1))
        stepper.step(np.array([0.3]), 100)
        np.testing.assert_allclose(stepper.data.qpos, data.qpos, atol=1e-5)
    with pytest.raises(InputError, match=r"holds the native effects already.*nominal\.xml"):
        CorrectedModel.load(out / "corrected.xml", out / "effects.json")


def test_models_are_written_with_the_files_they_need(tmp_path):
    source, out = tmp_path / "source", tmp_path / "out"
    (source / "meshes").mkdir(parents=True)
    (source / "meshes" / "tip.obj").write_text(
        "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    asset = '<mujoco><compiler meshdir="meshes"/><asset><mesh name="tip" file="tip.obj"/></asset>'
    tip = '<geom type="mesh" mesh="tip" contype="0" conaffinity="0"/></body></worldbody>'
    xml = PENDULUM.replace("<mujoco>", asset).replace("</body></worldbody>", tip)
    (source / "model.xml").write_text(xml)
    given = SimpleNamespace(spec=load_spec(source / "model.xml"))
    write_models(SimpleNamespace(prepared=given, fit=NOTHING, ctx=None, actuators=None, residual=None), out)
    shutil.rmtree(source)
    for name in ("nominal.xml", "corrected.xml"):
        assert mujoco.MjModel.from_xml_path(str(out / name)).nmesh == 1


def test_versions_name_this_project_even_where_it_is_not_installed(monkeypatch):
    from importlib import metadata

    def nothing(_name):
        raise metadata.PackageNotFoundError

    monkeypatch.setattr(metadata, "version", nothing)
    assert re.fullmatch(r"\d+\.\d+.*", tables._versions()["mpge_jax"])


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.images: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        if tag == "img":
            self.images.append(dict(attrs)["src"])


def test_report_is_self_contained_and_escaped(result):
    out, _ = result
    text = (out / "report.html").read_text()
    page = _Page()
    page.feed(text)
    assert not {"script", "i"} & set(page.tags) and "&lt;script&gt;" in text
    assert "model&lt;i&gt;.xml" in text and "run_0&lt;img src=x&gt;" in text
    assert len(page.images) == 7 and "Whole held-out recordings" in text
    assert "@media (prefers-color-scheme:dark)" in text and "@media print" in text
    for source in page.images:
        assert base64.b64decode(source.removeprefix("data:image/png;base64,"))[:4] == b"\x89PNG"
    assert not re.search(r'(?:src|href)="https?:', text)


def test_report_opens_in_a_browser_without_errors(result, tmp_path):
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no chromium here: the report was not opened in a browser")
    out, _ = result
    probe = tmp_path / "probe.html"
    script = (
        "<script>addEventListener('load',()=>{const i=[...document.images];"
        "document.title='shown '+i.filter(x=>x.complete&&x.naturalWidth>0).length+' of '+i.length})</script>"
    )
    probe.write_text((out / "report.html").read_text().replace("</body>", script + "</body>"))
    command = [
        browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
        "--enable-logging=stderr", "--v=0", "--virtual-time-budget=3000", "--dump-dom", probe.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert "<title>shown 7 of 7</title>" in done.stdout
    assert "CONSOLE" not in done.stderr


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a | {"--model": ["none.xml"]}, "does not exist"),
        (lambda a: a | {"--recordings": ["none.npz"]}, "does not exist"),
        (lambda a: a | {"--effects": ["gremlins"]}, "unknown effect 'gremlins'"),
        (lambda a: a | {"--held-out": ["gremlins"]}, "'gremlins' is not among"),
        (lambda a: a | {"--map": ["none.yaml"]}, "cannot read the map"),
        (lambda a: a | {"--jobs": ["0"]}, "at least 1"),
    ],
)
def test_bad_input_ends_with_one_sentence_and_writes_nothing(folder, tmp_path, capsys, change, message):
    out = tmp_path / "out"
    arguments = {"--model": [str(folder / MODEL)], "--recordings": [str(folder)], "--out": [str(out)]}
    arguments = change(arguments)
    assert main([x for k, v in arguments.items() for x in (k, *v)]) == 2
    (error,) = capsys.readouterr().err.strip().splitlines()
    assert error.startswith("error: ") and message in error
    assert not out.exists()


def test_a_folder_that_cannot_be_made_is_told_before_the_search(folder, tmp_path, capsys, monkeypatch):
    import experiments.diagnose as command

    monkeypatch.setattr(command, "diagnose", lambda *_args: pytest.fail("the search was started"))
    (tmp_path / "file").write_text("")
    arguments = ["--model", str(folder / MODEL), "--recordings", str(folder), "--out"]
    for out in ("file", "file/out", "file/a/b"):
        assert main([*arguments, str(tmp_path / out)]) == 2
        assert "is a file; give another one." in capsys.readouterr().err
    monkeypatch.setattr(command.os, "access", lambda *_args: False)
    assert main([*arguments, str(tmp_path / "new" / "out")]) == 2
    assert "no permission" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_two_diagnoses_into_one_folder_are_refused(folder, tmp_path, capsys, monkeypatch):
    import experiments.diagnose as command

    monkeypatch.setattr(command, "diagnose", lambda *_args: pytest.fail("the search was started"))
    arguments = ["--model", str(folder / MODEL), "--recordings", str(folder), "--out", str(tmp_path)]
    with files.held(tmp_path):
        assert main(arguments) == 2
    (error,) = capsys.readouterr().err.strip().splitlines()
    assert error.startswith(f"error: {tmp_path} is in use by another run (process ")


def test_recordings_shorter_than_a_window_are_told(folder, tmp_path, capsys):
    short = tmp_path / "short.npz"
    np.savez(short, time=[0.0, 0.01, 0.02, 0.03], qpos=np.zeros((4, 1)), ctrl=np.zeros((4, 1)))
    arguments = [
        "--model",
        str(folder / MODEL),
        "--recordings",
        str(short),
        "--out",
        str(tmp_path / "o"),
    ]
    assert main(arguments) == 2
    assert "record more" in capsys.readouterr().err


def test_a_diagnosis_is_printed_as_its_verdict_and_warnings():
    runs = record(PENDULUM, 0.3, count=2, seconds=1.5)
    d = diagnose(mujoco.MjSpec.from_string(PENDULUM), runs, Config(jobs=1, effects=tuple(EFFECTS)))
    d.warnings.append("look out.")
    assert d.verdict == "none"
    assert str(d).startswith("none: Nothing is missing") and str(d).endswith("\nwarning: look out.")
    assert repr(d).startswith(f"Diagnosis('none', effects=[], warnings={len(d.warnings)}, seconds=")


def test_settings_that_are_no_config_are_refused_in_one_sentence(folder):
    with pytest.raises(InputError, match=r"as Config\(seed=0\), not as dict"):
        diagnose(folder / MODEL, folder, {"seed": 0})


def _hum(model, data):
    """A force that nothing but time sets."""
    data.qfrc_applied[0] = 0.08 * np.sin(9.0 * data.time) * np.sin(2.3 * data.time)


VERDICTS = {
    "none": (PENDULUM, None, EFFECTS),
    "unexplained": (FINE_PENDULUM, _hum, EFFECTS),
    "ambiguous": (
        FINE_PENDULUM.replace("<option", '<option gravity="0 0 0"'),
        None,
        ["coulomb_friction", "actuator_bias"],
    ),
}


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_is_written_in_the_same_form(verdict, tmp_path):
    xml, force, effects = VERDICTS[verdict]
    recordings = _turning_forwards(xml) if verdict == "ambiguous" else record(xml, 1.2, force=force)
    d = diagnose(mujoco.MjSpec.from_string(xml), recordings, Config(jobs=1, effects=tuple(effects)))
    d.write(tmp_path)
    table = json.loads((tmp_path / "diagnosis.json").read_text())
    assert table["verdict"] == verdict
    assert set(table) == {
        "schema", "verdict", "effects", "ambiguous", "unexplained", "location", "fit", "explanation", "warnings",
        "seed", "versions", "residual", "given_inertias",
    }  # fmt: skip
    assert (table["unexplained"] is None) == (verdict != "unexplained")
    if verdict == "unexplained":
        u = table["unexplained"]
        assert u["at"] == ["hinge"] and 0.5 < u["share"] <= 1.0 and u["when"]
        assert {name for name, *_ in u["intervals"]} <= {r.name for r in recordings}
        assert all(0.0 <= a < b <= 2.0 for _, a, b in u["intervals"])
    if verdict == "ambiguous":
        (entry,) = table["ambiguous"]
        found = {(c["id"], c["at"]) for (c,) in entry["candidates"]}
        assert found == {("coulomb_friction", "hinge"), ("actuator_bias", "motor")}
        assert entry["experiment"] == "next_experiment.npz" and (tmp_path / "next_experiment.npz").is_file()
    else:
        assert table["ambiguous"] == [] and table["effects"] == []
    page = (tmp_path / "report.html").read_text()
    assert f'<span class="badge {verdict}">' in page and page.count("data:image/png") == 7
    # where nothing was corrected there is nothing to set beside the model as given
    assert ("<th>corrected</th>" in page) is (verdict == "ambiguous")
    assert f"{len(recordings)} recordings; report of" in page and all(
        f"<td>{r.name}</td>" in page for r in recordings
    )
    if d.warnings:
        assert all(html.escape(w) in page for w in d.warnings)
        assert page.index("Take note") < page.index("Whole held-out recordings")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml")).nv == 1


def _turning_forwards(xml: str) -> list[Recording]:
    """A machine with dry friction of 0.05 N m that never turns back."""
    out, rng = [], np.random.default_rng(0)
    for k in range(3):
        model = mujoco.MjModel.from_xml_string(xml)
        data, rows = mujoco.MjData(model), []
        data.qvel[0] = 5.0
        for i in range(201):
            data.ctrl[0] = 0.2 + 0.1 * np.sin(0.2 * i + k)
            rows.append((0.01 * i, data.qpos[0], data.ctrl[0]))
            data.qfrc_applied[0] = -0.05
            mujoco.mj_step(model, data, 5)
        t, q, u = np.array(rows).T
        out.append(
            Recording(f"run_{k}", t, (q + 1e-4 * rng.standard_normal(q.size))[:, None], None, u[:, None])
        )
    return out


def test_nothing_is_found_where_nothing_is_missing():
    recordings = record(PENDULUM, 1.2, seed=3)
    config = Config(jobs=1, effects=tuple(EFFECTS), seed=1)
    first, second = (diagnose(mujoco.MjSpec.from_string(PENDULUM), recordings, config) for _ in range(2))
    assert first.verdict == "none" and not first.terms
    assert first.to_json() == second.to_json()


def test_an_interrupted_search_goes_on_where_it_was(folder, result, tmp_path, monkeypatch, capsys):
    import mpge_jax.diagnosis.pipeline as whole
    import mpge_jax.diagnosis.selection.procedure as decisions

    out, (whole_out, _) = tmp_path / "out", result
    arguments = ["--model", str(folder / MODEL), "--recordings", str(folder), "--jobs", "1", "--quiet"]
    arguments += ["--effects", *EFFECTS, "--out", str(out)]

    def interrupt(*_args, **_named):
        raise KeyboardInterrupt

    for module, part in ((whole.Diagnosis, "write"), (decisions, "find_rivals")):
        with monkeypatch.context() as patch:
            patch.setattr(module, part, interrupt)
            assert main(arguments) == 130
        assert "go on" in capsys.readouterr().err
        assert (out / ".progress.json").exists()
    kept = json.loads((out / ".progress.json").read_text())
    assert [t["id"] for t in kept["fit"]["terms"]] == ["coulomb_friction"] and kept["work"] > 0
    assert kept["looked"] is False

    short = tmp_path / "short.json"
    short.write_text(json.dumps({**kept, "fit": {**kept["fit"], "theta": [], "centre": []}}))
    works, attach = [], whole.checkpoint.attach
    monkeypatch.setattr(
        whole.checkpoint, "attach", lambda s, p, path: (attach(s, p, path), works.append(p.sim.work))
    )
    logs = []
    original = whole.find
    monkeypatch.setattr(whole, "find", lambda *a: logs.append(original(*a)) or logs[-1])
    drawn = {path.stem: path for path in (whole_out / "figures").iterdir()}
    monkeypatch.setattr(report_folder, "draw", lambda *_: drawn)
    assert main(arguments) == 0
    assert not any(line.startswith("round 1") for line in logs[0].log)
    assert [t.id for t in logs[0].terms] == ["coulomb_friction"]
    assert works == [kept["work"]]
    search = build_search(logs[0].prepared, lambda _text: None, 0.25)
    attach(search, logs[0].prepared, short)
    assert not search.resume.fit.hypothesis.terms
    assert not (out / ".progress.json").exists()
    assert (out / "diagnosis.json").read_bytes() == (whole_out / "diagnosis.json").read_bytes()
