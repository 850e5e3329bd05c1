"""What the README says is so: its examples run, its commands are understood, its names exist.

Links, and the commands of all pages: tests/documentation."""

import re
import shlex
import textwrap
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tyro

import envs
from envs import registry
from experiments import diagnose, inspect, new, pretrain, sweep
from experiments.benchmark import __main__ as benchmark
from experiments.fleet import __main__ as fleet
from experiments.methods import METHODS
from experiments.presets import PRESETS
from experiments.results import page as results
from mpge_jax.diagnosis import Config

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_the_library_examples_ground_a_simulator_and_name_what_it_lacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = BLOCKS[0]
    assert code.count("iterations=80") == 1
    names: dict = {}
    exec(code.replace("iterations=80", "iterations=1, num_envs=8, steps_per_iteration=16"), names)
    assert names["log"].steps == 1000
    assert names["curve"]["reward"].shape == (1,)
    state = names["state"]
    assert state.obs.shape == (4,)
    assert np.isfinite(state.obs).all()
    assert state.reward == 1.0
    exec(BLOCKS[1], names)
    assert names["own_log"].action.shape == (2, 500, 1)
    monkeypatch.chdir(tmp_path)
    # Among what else pushes at a slide or comes out of its motor: all others only take time.
    rivals = ("actuator_gain", "external_force", "gravity_tilt", "coulomb_friction", "encoder_offset")
    names["few"] = Config(jobs=1, effects=("actuator_bias", *rivals))
    call = 'recordings_of(log, "InvertedPendulum"))'
    assert BLOCKS[2].count(call) == 1
    exec(BLOCKS[2].replace(call, call[:-1] + ", few)"), names)
    assert [(t.name, t.place.name) for t in names["d"].terms] == [("actuator_bias", "slide")]
    assert (tmp_path / "out" / "report.html").is_file()


def test_the_example_of_a_target_changes_model_and_action(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_variants", dict(registry._variants))
    names: dict = {}
    exec(BLOCKS[3], names)
    tired = names["tired"]
    np.testing.assert_allclose(tired.model.opt.gravity, [0.5, 0.0, -9.8])
    # The same motion as the tilted model without the weak motor gives at 0.6 of the command.
    tilted = envs.Env(tired.task, tired.model, tired.engine)
    first = tired.reset(jax.random.key(0))
    got = jax.jit(tired.step)(first, jnp.asarray([2.0]))
    wanted = jax.jit(tilted.step)(first, jnp.asarray([1.2]))
    np.testing.assert_allclose(got.obs, wanted.obs, rtol=1e-6)
    cells, _ = sweep.cells_of(sweep.Args(task="TiredPendulum", method=("direct",)))
    assert [cell.task for cell in cells] == ["TiredPendulum"]


def test_the_lines_for_brax_put_a_copy_on_each_device(monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"\n( {4}jax\.device_put_replicated = (?:.*\n)+? {4}\)\n)", README)
    monkeypatch.setattr(jax, "device_put_replicated", None, raising=False)
    exec(textwrap.dedent(code), {"jax": jax})
    copies = jax.device_put_replicated({"a": jnp.arange(3)}, jax.local_devices() * 2)
    np.testing.assert_array_equal(copies["a"], [[0, 1, 2]] * 2 * len(jax.local_devices()))


def commands(module: str) -> list[list[str]]:
    """The arguments of every `python -m module ...` in the README."""
    found = re.findall(rf"python -m {re.escape(module)}([^`\n]*)", README)
    assert found, f"the README does not show {module}"
    return [shlex.split(arguments, comments=True) for arguments in found]


def test_the_commands_are_understood() -> None:
    for arguments in commands("experiments.sweep"):
        asked = tyro.cli(sweep.Args, args=arguments)
        if asked.target_log:  # of a robot that is nobody's
            continue
        cells, preset = sweep.cells_of(asked)
        assert cells
        assert preset.name in PRESETS
    for arguments in commands("experiments.diagnose"):
        assert diagnose.parser().parse_args(arguments).model
    for arguments in commands("experiments.inspect"):
        assert inspect.parser().parse_args(arguments).log
    for module, tool in (
        (benchmark, "benchmark"),
        (results, "results"),
        (pretrain, "pretrain"),
        (fleet, "fleet"),
        (new, "new"),
    ):
        for arguments in commands(f"experiments.{tool}"):
            tyro.cli(module.Args, args=arguments)


def test_every_method_and_preset_is_explained() -> None:
    for name in (*METHODS, *PRESETS):
        assert f"`{name}`" in README, f"the README does not mention {name}"


def test_functions_of_the_environments_exist() -> None:
    named = set(re.findall(r"`envs\.(\w+)", README))
    assert {"as_gymnasium", "as_gymnasium_vector", "as_playground", "as_brax", "as_gymnax"} <= named
    assert [name for name in named if not hasattr(envs, name)] == []


def test_make_targets_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    mentioned = set(re.findall(r"(?:`| {4})make ([a-z-]+)", README))
    assert {"demo", "sweep", "test", "docs"} <= mentioned
    assert mentioned <= targets
