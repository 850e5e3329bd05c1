"""Tasks of a user's own, from a file: what sweeps and other processes make of `path/to/file.py:NAME`."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import envs
from envs import registry
from experiments import pretrain, sweep
from experiments.presets import PRESETS
from mpge_jax.rollouts import policies
from tests import small
from tests.experiments.tiny import TINY

ROOT = Path(__file__).resolve().parents[2]

OWN = '''"""A pendulum and a target of it."""
import dataclasses

import envs

POLE = dataclasses.replace(envs.make("InvertedPendulum", "c").task, name="OwnPole")
WEAK = envs.Variant("WeakPole", "OwnPole", "weak motor", action=lambda action, low, high: 0.5 * action)
'''


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The file, with registrations that end with the test."""
    for name in ("_tasks", "_variants", "_homes"):
        monkeypatch.setattr(registry, name, dict(getattr(registry, name)))
    monkeypatch.setitem(PRESETS, "tiny", TINY)
    (tmp_path / "own.py").write_text(OWN)
    return tmp_path / "own.py"


def run(monkeypatch, *arguments) -> int:
    monkeypatch.setattr(sys, "argv", ["sweep", *map(str, arguments)])
    return sweep.main()


def test_a_reference_is_a_name_like_any_other(own):
    env = envs.make(f"{own}:WeakPole", "c")
    assert (env.name, env.task.name, envs.source_of(f"{own}:WeakPole")) == ("WeakPole", "OwnPole", "OwnPole")
    # Read once: the same task, under its plain name too.
    assert envs.make("OwnPole", "c").task is env.task
    assert envs.home_of("OwnPole") == own.parent and envs.home_of("Hopper") is None
    assert policies.shipped_path("OwnPole", "MS") == own.parent / "policy_sets" / "OwnPole-MS.npz"


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        (None, "X", "{} does not exist; give the path of a Python file"),
        (
            "x = 1",
            "X",
            "{} defines no envs.Task or envs.Variant at its top level; `python -m experiments.new",
        ),
        (OWN, "Pole", "{} does not define 'Pole': write {}:NAME with NAME one of OwnPole, WeakPole"),
        (OWN, "", "{} defines several things: write {}:NAME with NAME one of OwnPole, WeakPole"),
        (
            OWN.replace("OwnPole", "Hopper"),
            "Hopper",
            "{} defines 'Hopper', the name of another environment; give",
        ),
        ("import envs\n\n1 / 0", "X", "{} cannot be used: ZeroDivisionError in line 3: division by zero"),
        ("import env", "X", "{} cannot be used: ModuleNotFoundError in line 1: No module named 'env'"),
        (OWN, "OwnPole", "--task {}:OwnPole is a source task: name a target, an envs.Variant of it"),
        (
            OWN,
            "WeakPole",
            "OwnPole has no MS set of policies yet: python -m experiments.pretrain --task {}:OwnPole",
        ),
    ],
)
def test_what_cannot_be_used_is_one_sentence(own, monkeypatch, capsys, tmp_path, text, name, message):
    path = tmp_path / "mine.py"
    if text is not None:
        path.write_text(text)
    task = f"{path}:{name}" if name else str(path)
    assert run(monkeypatch, "--task", task, "--method", "direct", "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("sweep: " + message.replace("{}", str(path))) and "\n" not in said
    assert not (tmp_path / "out").exists()


def test_a_sweep_on_a_target_of_ones_own(own, monkeypatch, capsys, tmp_path):
    policies.save(
        policies.shipped_path(envs.plain_name(f"{own}:OwnPole"), "MS"), small.policy_set(), {"updates": 0}
    )
    out = tmp_path / "out"
    command = ("--task", f"{own}:WeakPole", "--preset", "tiny", "--method", "direct", "--quiet", "--out", out)
    command += ("--backend", "c")
    assert run(monkeypatch, *command) == 0
    (row, _) = json.loads((out / "results.json").read_text())["rows"]
    assert row["task"] == f"{own}:WeakPole" and 1 <= row["return_stochastic"] <= 1000
    # Resumed from another folder, it is the same task; changed, it is another one.
    monkeypatch.chdir(own.parent)
    capsys.readouterr()
    assert run(monkeypatch, "--task", "own.py:WeakPole", *command[2:]) == 0
    assert "done before" in capsys.readouterr().err
    own.write_text(OWN.replace("0.5", "0.4"))
    assert run(monkeypatch, *command) == 2
    assert "holds another sweep (task_file differ)" in capsys.readouterr().err


def test_another_process_finds_it_by_the_name_in_the_record(own):
    code = f"import envs; print(envs.make('{own}:WeakPole', 'c').observation_size)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout == "4\n", done.stderr


def test_policies_of_an_own_task_lie_beside_its_file(own, monkeypatch, tmp_path):
    asked = []

    def train(args, folder):
        asked.append((args.task, folder))
        return small.policy_set(), {}

    monkeypatch.setattr(pretrain, "train", train)
    monkeypatch.setattr(pretrain, "returns_of", lambda *_: {"deterministic": [1.0]})
    pretrain.main(pretrain.Args(task=f"{own}:OwnPole"))
    loaded, about = policies.shipped("OwnPole", "MS")
    assert loaded.size == 3 and about["returns"] == {"deterministic": [1.0]}
    assert (own.parent / "policy_sets" / "OwnPole-MS.npz").is_file()
    with pytest.raises(ValueError, match="WeakPole is a target; policies are trained in its source, OwnPole"):
        pretrain.main(pretrain.Args(task=f"{own}:WeakPole"))
