"""Where results cannot be written every command says so in one sentence, before it works for hours."""

import resource
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments import diagnose, facts, inspect, new, pretrain
from experiments.blind import __main__ as blind
from experiments.demo import __main__ as demo
from experiments.fleet import __main__ as fleet
from experiments.results import page as results
from experiments.scale import __main__ as scale
from experiments.second_author import __main__ as second_author
from mpge_jax import files
from tests.diagnosis.machines import PENDULUM, record

ROOT = Path(__file__).resolve().parents[2]
GIVEN = ("--model", "model.xml")
COMMANDS = {
    "diagnose": (diagnose.main, [*GIVEN, "--recordings", "logs", "--effects", "armature", "--quiet"]),
    "inspect": (inspect.main, ["logs", *GIVEN]),
    "fleet": (fleet.main, [*GIVEN, "--robots", "robots", "--effects", "armature"]),
    "demo": (demo.main, ["--no-open", "--quiet"]),
    "new": (new.main, ["model.xml"]),
    "pretrain": (pretrain.command, ["--task", "InvertedPendulum"]),
    "results": (results.main, [str(ROOT / "docs" / "results" / "SkewedPendulum-standard")]),
    "facts": (facts.main, []),
    "blind build": (blind.main, ["build", "--seed", "1"]),
    "second_author build": (second_author.main, ["build"]),
    "scale robots": (scale.main, ["robots", "--joints", "1"]),
}


@pytest.fixture
def given(tmp_path, monkeypatch):
    """A folder with what the commands are given, in which they run; gives a function that runs one."""
    (tmp_path / "model.xml").write_text(PENDULUM)
    for r in record(PENDULUM, 1.0, count=2, seconds=1.0):
        for folder in ("logs", "robots/first"):
            (tmp_path / folder).mkdir(parents=True, exist_ok=True)
            np.savez(tmp_path / folder / f"{r.name}.npz", time=r.time, qpos=r.qpos, ctrl=r.ctrl)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "off")

    def run(name: str, out: str) -> int:
        main, arguments = COMMANDS[name]
        monkeypatch.setattr(sys, "argv", [name, *arguments, "--out", out])
        if main in (new.main, fleet.main, pretrain.command, results.main, facts.main):
            return main()
        return main(sys.argv[1:])

    return run


@pytest.mark.parametrize("name", COMMANDS)
def test_a_file_in_the_way_is_one_sentence(given, capsys, name):
    Path("file").write_text("important")
    assert given(name, "file/below.py" if name == "new" else "file/below/out") == 2
    said = capsys.readouterr().err.strip().splitlines()
    # before it the benchmark shows its progress
    assert len(said) == 1 + (name == "blind build") and "file" in said[-1] and "[Errno" not in said[-1]
    assert Path("file").read_text() == "important"


@pytest.mark.parametrize("name", ["diagnose", "inspect", "fleet", "new", "results", "facts", "scale robots"])
def test_a_full_disk_is_one_sentence_and_the_next_try_goes_on(given, capsys, name):
    out = "out.py" if name == "new" else "out.md" if name in ("results", "facts") else "out"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200, before[1]))
    try:
        status = given(name, out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert status == 2 and "File too large" in said and "[Errno" not in said
    assert given(name, out) == 0


@pytest.mark.parametrize("name", ["diagnose", "fleet", "demo", "pretrain"])
def test_a_folder_that_another_run_holds_is_one_sentence(given, capsys, name):
    with files.held(Path("out") / "pretrain" if name == "pretrain" else "out"):
        assert given(name, "out") == 2
    said = capsys.readouterr().err.strip()
    assert "in use by another run (process " in said and "\n" not in said
    assert not Path("out").exists()
