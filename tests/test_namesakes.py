"""Folders of one's own called `envs` or `experiments` beside the library."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from mpge_jax import commands

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def beside(tmp_path):
    """A folder that holds a package `envs` and a package `experiments` of somebody's own."""
    for name in ("envs", "experiments"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("mine = True\n")
    return tmp_path


def _run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def _script(command: str) -> str:
    """What the installation puts beside Python."""
    return str(Path(sys.executable).with_name(f"mpge-{command}"))


def test_the_diagnosis_works_beside_them_and_needs_no_jax(beside):
    code = "import sys, mpge_jax.diagnosis as d; d.diagnose; assert not {'jax', 'envs'} & set(sys.modules)"
    done = _run(beside, sys.executable, "-c", code)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "wanted", ["mpge_jax; mpge_jax.ground", "mpge_jax.learning.sac", "mpge_jax.diagnosis.corrected.tasks"]
)
def test_what_needs_the_environments_says_whose_stand_in_their_place(beside, wanted):
    done = _run(beside, sys.executable, "-c", f"import {wanted}")
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith(f"ImportError: {beside / 'envs'} stands before this library's own package 'envs'")


def test_commands_work_beside_them(beside):
    done = _run(beside, _script("diagnose"), "--list-effects")
    assert done.returncode == 0 and "coulomb_friction" in done.stdout, done.stderr


def test_they_run_from_any_folder(tmp_path):
    """Nothing of the folder is needed, and nothing is left in it."""
    (tmp_path / "m.xml").write_text("<mujoco/>")
    done = _run(tmp_path, _script("inspect"), "nowhere.csv", "--model", "m.xml")
    assert (done.returncode, done.stderr) == (
        2,
        "error: the model has no joint, so there is nothing to diagnose.\n",
    )
    assert [p.name for p in tmp_path.iterdir()] == ["m.xml"]


@pytest.mark.parametrize(("command", "package"), [("inspect", "experiments"), ("sweep", "envs")])
def test_a_clash_is_one_sentence(beside, command, package):
    """Where the path leads to one's own folders first, as it does by PYTHONPATH."""
    other = "envs" if package == "experiments" else "experiments"
    (beside / other / "__init__.py").unlink()
    (beside / other).rmdir()
    code = (
        f"import sys; sys.path.insert(0, '.'); from mpge_jax import commands; sys.exit(commands.{command}())"
    )
    done = _run(beside, sys.executable, "-c", code, "x")
    said = done.stderr.strip()
    assert done.returncode == 2 and "\n" not in said
    assert said.startswith(
        f"mpge-{command}: {beside / package} stands before this library's own package '{package}'"
    )


@pytest.mark.parametrize("command", ["demo", "sweep"])
def test_a_module_that_is_run_says_it_in_one_sentence_too(beside, command):
    """`experiments` is found, and `envs` is another's."""
    (beside / "experiments" / "__init__.py").unlink()
    (beside / "experiments").rmdir()
    done = _run(beside, sys.executable, "-m", f"experiments.{command}", "--help")
    said = done.stderr.strip()
    assert done.returncode == 2 and "\n" not in said and not done.stdout
    assert said.startswith(f"{beside / 'envs'} stands before this library's own package 'envs'")


def test_every_command_has_a_script():
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    for name, target in scripts.items():
        assert target == f"mpge_jax.commands:{name.removeprefix('mpge-')}"
        assert callable(getattr(commands, name.removeprefix("mpge-")))


def test_names_of_the_package_are_those_it_lists():
    import mpge_jax

    assert sorted(mpge_jax._HOME) == sorted(mpge_jax.__all__)
    assert all(getattr(mpge_jax, name).__name__ == name for name in mpge_jax.__all__)
    with pytest.raises(AttributeError, match="'mpge_jax' has no attribute 'grund'"):
        mpge_jax.grund  # noqa: B018
