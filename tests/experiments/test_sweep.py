"""The main job: what it refuses, what it skips and records, and whole sweeps on tiny budgets."""

import csv
import dataclasses
import json
import os
import random
import resource
import subprocess
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments import methods, sweep
from experiments.methods import METHODS, Outcome, recording, training
from experiments.presets import PRESETS
from mpge_jax import files
from mpge_jax.learning import agent
from mpge_jax.rollouts import policies, target_log
from tests import small
from tests.experiments.tiny import TINY

ROOT = Path(__file__).resolve().parents[2]


def run(monkeypatch, *arguments) -> int:
    """The command's exit status."""
    monkeypatch.setattr(sys, "argv", ["sweep", *map(str, arguments)])
    return sweep.main()


def tree_of(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def shipped(task: str, kind: str, coefficient: float = 0.1):
    return small.policy_set(task, seed=len(kind)), {"entropy_coefficient": coefficient}


@pytest.fixture
def tiny(monkeypatch):
    """The tiny preset, on small untrained policies."""
    monkeypatch.setitem(PRESETS, "tiny", TINY)
    monkeypatch.setattr(policies, "shipped", shipped)


def outcome(cell: methods.Cell, value: float = 250.0, agents=None) -> Outcome:
    """A result as `methods.run` gives it: returns `value`, `value + 100`, ... by seed."""
    rows = [
        {
            "task": cell.task,
            "method": cell.method,
            "samples": cell.samples,
            "seed": seed,
            "target_steps": cell.samples,
            "return_stochastic": value + 100.0 * seed,
            "return_deterministic": value,
            "return_stochastic_std": 1.0,
            "return_deterministic_std": 1.0,
            **({"transform_error": 0.25} if cell.samples else {}),
        }
        for seed in cell.seeds
    ]
    grounded = cell.samples and cell.method != "GAT"
    curve = {"error_uniform": np.linspace(1.0, 0.3, 8).reshape(4, 2, 1)} if grounded else {}
    return Outcome(rows, 0.0, curve, None, agents or small.policy_set())


given_threads: list[int] = []
"""Of the cells that `faked` ran."""


@pytest.fixture
def faked(monkeypatch, tiny):
    """Cells that cost nothing; the list of those that ran. `SPG` fails as long as `broken` is in the list."""
    ran = []
    given_threads.clear()

    def fake(cell, folder, quiet, threads):
        ran.append((cell.method, cell.samples))
        given_threads.append(threads)
        if cell.method == "SPG" and "broken" in ran:
            raise FloatingPointError("the simulation diverged\nand here are a thousand lines of XLA")
        return outcome(cell)

    monkeypatch.setattr(methods, "run", fake)
    return ran


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--task", "SkewPendulum"], "--task SkewPendulum is not known; did you mean SkewedPendulum?"),
        (["--task", "HalfCheetah"], "--task HalfCheetah is not known"),
        (["--method", "direct", "MPGE-M"], "--method MPGE-M is not known; did you mean MPGE-MS?"),
        (["--preset", "standart"], "--preset standart is not known; did you mean standard?"),
        (["--backend", "cc"], "--backend cc is not known; did you mean c?"),
        (["--dynamics", "legasy"], "--dynamics legasy is not known; did you mean legacy?"),
        (["--samples", "1000", "4"], "--samples 4 is smaller than the number of rollout policies, 5"),
        (["--preset", "fast"], "--preset fast is not known (allowed: quick, "),
        (["--task", "NoSuch"], "--task NoSuch is not known (allowed: SkewedPendulum, "),
        (["--seeds", "0"], "--seeds must be at least 1, got 0"),
    ],
)
def test_what_cannot_be_run_is_one_sentence_and_status_2(monkeypatch, capsys, tmp_path, arguments, message):
    out = tmp_path / "out"
    assert run(monkeypatch, *arguments, "--out", out) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith(f"sweep: {message}") and "\n" not in said
    assert not out.exists()


@pytest.mark.parametrize("arguments", [["--seeds", "two"], ["--tusk", "SkewedPendulum"]])
def test_a_command_line_that_cannot_be_parsed_ends_with_status_2(monkeypatch, capsys, arguments):
    with pytest.raises(SystemExit) as status:
        run(monkeypatch, *arguments)
    assert status.value.code == 2


def test_the_command_itself_refuses_with_status_2(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "experiments.sweep", "--task", "BrokenHoper", "--out", str(tmp_path / "out")],
        cwd=ROOT,
        env={**os.environ, "JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr.strip().startswith(
        "sweep: --task BrokenHoper is not known; did you mean BrokenHopper?"
    )
    assert "Traceback" not in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("width", [40, 80, 200])
def test_the_configuration_is_told_without_a_broken_word(monkeypatch, capsys, tmp_path, faked, width):
    monkeypatch.setenv("COLUMNS", str(width))
    run(monkeypatch, "--preset", "tiny", "--method", "direct", "--out", tmp_path)
    said = capsys.readouterr().err.split()
    settings = TINY.tasks["InvertedPendulum"]
    for config in (settings, settings.grounding, settings.grounding.discriminator, settings.agent.sac):
        for field in dataclasses.fields(config):
            assert any(word.startswith((f"{field.name}=", f"{field.name}:")) for word in said), field.name


def test_a_folder_of_another_sweep_is_refused_and_kept(monkeypatch, capsys, tmp_path, faked):
    run(monkeypatch, "--preset", "tiny", "--method", "direct", "--out", tmp_path)
    before, cells = tree_of(tmp_path), len(faked)
    for change, what in (
        (["--seeds", 3], "seeds"),
        (["--preset", "quick"], "preset"),
        (["--dynamics", "legacy"], "dynamics"),
        (["--task", "BrokenHopper", "--preset", "quick"], "preset, task"),
    ):
        capsys.readouterr()
        assert run(monkeypatch, "--preset", "tiny", "--method", "direct", "--out", tmp_path, *change) == 2
        assert f"holds another sweep ({what} differ); choose another --out" in capsys.readouterr().err
    changed = dataclasses.replace(TINY, members=3)
    monkeypatch.setitem(PRESETS, "tiny", changed)
    assert run(monkeypatch, "--preset", "tiny", "--method", "direct", "--out", tmp_path) == 2
    assert "holds another sweep (preset differ)" in capsys.readouterr().err
    assert tree_of(tmp_path) == before and len(faked) == cells


def test_other_policies_than_cells_before_started_from_are_refused(monkeypatch, capsys, tmp_path, faked):
    """The sets of the user's own: another set of the same name would mix two experiments, and read a log that is not
    its own."""
    sets = tmp_path / "sets"
    sets.mkdir()
    for kind in ("MS", "ER"):
        (sets / kind).write_text(kind)
    monkeypatch.setattr(policies, "shipped_path", lambda task, kind, coefficient=0.1: sets / kind)
    out, given = tmp_path / "out", ("--preset", "tiny", "--out", tmp_path / "out")
    assert run(monkeypatch, *given, "--method", "direct") == 0
    assert list(json.loads((out / "inputs.json").read_text())) == ["the MS policies of InvertedPendulum"]
    # a set that no cell started from yet may change
    (sets / "ER").write_text("anew")
    assert run(monkeypatch, *given, "--method", "direct", "MPG-ER", "--samples", 40) == 0
    before, cells = tree_of(out), len(faked)
    (sets / "MS").write_text("anew")
    assert run(monkeypatch, *given, "--method", "direct", "SPG", "--samples", 40) == 2
    assert (
        f"changed since the sweep in {out} began: the MS policies of InvertedPendulum; choose"
        in capsys.readouterr().err
    )
    assert tree_of(out) == before and len(faked) == cells


@pytest.mark.parametrize("record", ["", "{", "[]", '{"identity": 3}', '{"versions": {}}'])
def test_a_damaged_record_is_refused_and_kept(monkeypatch, capsys, tmp_path, faked, record):
    (tmp_path / "sweep.json").write_text(record)
    assert run(monkeypatch, "--preset", "tiny", "--method", "direct", "--out", tmp_path) == 2
    said = capsys.readouterr().err.strip()
    assert "sweep.json cannot be read; move the folder away" in said and "\n" not in said
    assert tree_of(tmp_path) == {"sweep.json": record.encode()} and faked == []


def test_a_folder_of_something_else_is_refused_and_kept(monkeypatch, capsys, tmp_path, faked):
    (tmp_path / "thesis.tex").write_text("important")
    assert run(monkeypatch, "--preset", "tiny", "--method", "direct", "--out", tmp_path) == 2
    assert "is not empty and holds no sweep; choose another --out" in capsys.readouterr().err
    assert run(monkeypatch, "--preset", "tiny", "--method", "direct", "--out", tmp_path / "thesis.tex") == 2
    assert tree_of(tmp_path) == {"thesis.tex": b"important"} and faked == []


def test_a_full_disk_and_a_folder_that_cannot_be_written_are_one_sentence(
    monkeypatch, capsys, tmp_path, faked
):
    command = ("--preset", "tiny", "--method", "direct", "--out")
    assert run(monkeypatch, *command, "/proc/nowhere/out") == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("sweep: ") and "/proc/nowhere" in said and "\n" not in said
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        status = run(monkeypatch, *command, tmp_path / "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert status == 2 and said.startswith("sweep: cannot go on: ") and "File too large" in said
    # Where there is room again, it goes on.
    assert run(monkeypatch, *command, tmp_path / "out") == 0
    assert json.loads((tmp_path / "out" / "results.json").read_text())["rows"]


def test_cells_share_the_cores_between_them(monkeypatch, tmp_path, faked):
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    run(monkeypatch, "--preset", "tiny", "--method", "direct", "--out", tmp_path)
    assert given_threads == [8]


def test_an_empty_folder_and_one_of_a_sweep_killed_at_once_are_used(monkeypatch, tmp_path, faked):
    (tmp_path / "sweep.json.partial").write_text("{")
    assert run(monkeypatch, "--preset", "tiny", "--method", "direct", "--out", tmp_path) == 0
    assert faked == [("direct", 0)]


def test_a_failed_cell_is_recorded_the_others_go_on_and_it_is_tried_again(
    monkeypatch, capsys, tmp_path, faked
):
    command = (
        "--preset",
        "tiny",
        "--method",
        "direct",
        "SPG",
        "GAT",
        "--samples",
        10,
        1000,
        "--out",
        tmp_path,
    )
    faked.append("broken")
    assert run(monkeypatch, *command) == 1
    assert faked[1:] == [("direct", 0), ("SPG", 10), ("SPG", 1000), ("GAT", 10), ("GAT", 1000)]
    error = json.loads((tmp_path / "cells" / "SPG-10" / "error.json").read_text())["error"]
    assert "Traceback" in error and "a thousand lines" in error
    table = (tmp_path / "results.md").read_text()
    assert "SPG-10 failed: FloatingPointError: the simulation diverged\n" in table
    assert "a thousand lines" not in table
    assert {row["method"] for row in json.loads((tmp_path / "results.json").read_text())["rows"]} == {
        "direct",
        "GAT",
    }

    faked.clear()
    capsys.readouterr()
    assert run(monkeypatch, *command) == 0
    # What is done is not done again.
    assert faked == [("SPG", 10), ("SPG", 1000)]
    assert "done before" in capsys.readouterr().err
    assert not list(tmp_path.rglob("error.json"))
    assert "failed" not in (tmp_path / "results.md").read_text()

    # More cells may join later.
    faked.clear()
    assert run(monkeypatch, *command[:2], "--method", "target", "direct", *command[6:]) == 0
    assert faked == [("target", 0)]


def test_tables_show_mean_spread_and_the_papers_number(monkeypatch, tmp_path, faked):
    run(monkeypatch, "--preset", "tiny", "--method", "direct", "SPG", "GAT", "target", "--out", tmp_path)
    lines = (tmp_path / "results.md").read_text().splitlines()
    cells = {line.split("|")[1].strip(): [c.strip() for c in line.split("|")[2:-1]] for line in lines[2:]}
    # 250 and 350: the spread with ddof = 1 is 70.7, and t(0.975) with one degree of freedom is 12.71.
    # SPG's 293 at 1,000 samples and direct's 33.9 are the paper's.
    assert cells["SPG"] == [
        "1000",
        "2",
        "300 ± 71",
        "-335 to 935",
        "250 ± 0",
        "293",
        "0.250 ± 0.000",
        "1,000",
        "",
    ]
    assert cells["direct"] == ["-", "2", "300 ± 71", "-335 to 935", "250 ± 0", "34", "", "0", ""]
    assert cells["GAT"][5] == ""
    assert cells["target"][5] == "1000"
    assert list(cells) == ["direct", "SPG", "GAT", "target"]
    with (tmp_path / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 8
    assert {row["seed"] for row in rows} == {"0", "1"}
    record = json.loads((tmp_path / "results.json").read_text())
    assert record["identity"]["preset"]["members"] == 2
    assert {"commit", "jax", "mujoco", "python", "machine"} <= set(record["versions"])
    assert all(row["seconds"] >= row["grounding_seconds"] >= 0 for row in record["rows"])
    for name in ("returns.png", "errors.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    assert not list(tmp_path.rglob("*.partial"))


def test_seeds_rotate_the_policies_and_methods_of_one_set_share_their_log():
    cell = methods.Cell("SkewedPendulum", "MPG-MS", 100, (0, 1), TINY, "c", "mujoco")
    other = dataclasses.replace(cell, method="MPGE-MS")
    data = lambda keys: np.asarray(jax.random.key_data(keys))  # noqa: E731
    np.testing.assert_array_equal(data(cell.keys("log", "MS", "5")), data(other.keys("log", "MS", "5")))
    assert not np.array_equal(data(cell.keys("agent")), data(other.keys("agent")))
    assert not np.array_equal(data(cell.keys("agent"))[0], data(cell.keys("agent"))[1])
    # Adding a seed leaves the results of the others as they are.
    more = dataclasses.replace(cell, seeds=(0, 1, 2))
    np.testing.assert_array_equal(data(more.keys("agent"))[:2], data(cell.keys("agent")))


def test_a_set_of_fewer_policies_than_record_is_refused(monkeypatch):
    monkeypatch.setattr(policies, "shipped", lambda *_: (small.policy_set(size=1), {}))
    cell = methods.Cell("SkewedPendulum", "MPG-MS", 100, (0, 1), TINY, "c", "mujoco")
    with pytest.raises(ValueError, match="has 1 policies, and preset tiny records with 2; train as many"):
        recording.sets_of(cell, METHODS["MPG-MS"], "InvertedPendulum")
    assert recording.sets_of(cell, METHODS["SPG"], "InvertedPendulum").log_alpha.shape == (2, 1)


def test_agents_are_judged_as_they_explore_and_by_their_mode():
    cell = methods.Cell("SkewedPendulum", "direct", 0, (0, 1), TINY, "c", "mujoco")
    agents, target = small.policy_set(size=2, log_std=0.5), small.env("SkewedPendulum")
    found = training.evaluate(cell, target, agents)
    judge = jax.jit(jax.vmap(agent.evaluate, (0, None, 0, None, None)), static_argnums=(1, 3, 4))
    for name, stochastic in (("return_stochastic", True), ("return_deterministic", False)):
        keys = cell.keys(f"evaluation {name}")
        wanted = judge(keys, target, agents.actor, TINY.episodes, stochastic)
        np.testing.assert_array_equal(found[name], wanted)
    assert np.any(found["return_stochastic"] != found["return_deterministic"])


def assert_complete(folder, expected):
    rows = json.loads((folder / "results.json").read_text())["rows"]
    assert {(row["method"], row["samples"]) for row in rows} == expected
    for row in rows:
        # 8 random steps; 6 updates are 3 iterations of 2 environments and 4 steps.
        assert row["target_steps"] == (32 if row["method"] == "target" else row["samples"])
        assert all(np.isfinite(v) for v in row.values() if not isinstance(v, str))
        assert 1 <= row["return_stochastic"] <= 1000
        grounding = METHODS[row["method"]].grounding
        assert ("transform_error" in row) == (grounding is not None and row.get("simulator") != "corrected")
        assert ("verdict" in row) == row["method"].startswith("diagnosed")
    for method, samples in expected:
        cell = folder / "cells" / f"{method}-{samples}"
        # Checkpoints are gone, what was learned is kept.
        assert not any(path.is_dir() for path in cell.iterdir())
        assert policies.load(cell / "agents.npz")[0].size == 2
        if METHODS[method].samples == "log":
            logs = [target_log.load(cell / f"target_log_{seed}.npz") for seed in (0, 1)]
            assert [log.steps for log in logs] == [samples, samples]
            for log in logs:
                before, action, after = log.rows().values()
                moved = small.step_from("SkewedPendulum", before, action)
                np.testing.assert_allclose(after, moved, atol=2e-5, err_msg="not recorded in the target")
        if METHODS[method].grounding is not None:
            with np.load(cell / "transformers.npz", allow_pickle=False) as file:
                members = 2 if METHODS[method].ensemble else 1
                assert file["input_mean"].shape == (2, members, 5)
    for name in ("returns.png", "errors.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")


def test_a_whole_sweep_on_a_tiny_preset(monkeypatch, tmp_path, tiny):
    command = ("--preset", "tiny", "--samples", 11, "--backend", "c", "--quiet", "--out", tmp_path)
    assert run(monkeypatch, *command, "--method", "direct", "MPGE+") == 0
    assert_complete(tmp_path, {("direct", 0), ("MPGE+", 11)})
    # The source policy itself is what `direct` deploys.
    kept, _ = policies.load(tmp_path / "cells" / "direct-0" / "agents.npz")
    expected = policies.shipped("InvertedPendulum", "MS")[0].actor.params["params"]["Dense_1"]["bias"][:2]
    np.testing.assert_allclose(kept.actor.params["params"]["Dense_1"]["bias"], expected, atol=1e-3)


@pytest.mark.slow
def test_every_method_on_a_tiny_preset(monkeypatch, tmp_path, tiny):
    common = ("--preset", "tiny", "--backend", "c", "--quiet", "--out", tmp_path)
    # A diagnosis asks for more than a dozen rows.
    rows = {name: 200 if name.startswith("diagnosed") else 11 for name in METHODS}
    for samples in (11, 200):
        chosen = [name for name, count in rows.items() if count == samples]
        assert run(monkeypatch, *common, "--samples", samples, "--method", *chosen) == 0
    used = {(name, rows[name] if method.uses_samples else 0) for name, method in METHODS.items()}
    assert_complete(tmp_path, used)
    table = (tmp_path / "results.md").read_text()
    assert "| diagnosed | 200 | 1 | effects | actuator_bias at slide | corrected |" in table
    spg, several = (
        target_log.load(tmp_path / "cells" / f"{m}-11" / "target_log_1.npz") for m in ("SPG", "MPG-MS")
    )
    assert (spg.count.shape, several.count.shape) == ((1,), (2,))


def test_a_resumed_cell_takes_no_further_target_steps(monkeypatch, tmp_path, tiny):
    cell = methods.Cell("SkewedPendulum", "GAT", 11, (0, 1), TINY, "c", "mujoco")
    sets = jax.tree.map(lambda x: jnp.stack([x[:2], x[1:]]), small.policy_set())
    target = small.env("SkewedPendulum")
    logs = recording.record(cell, METHODS["GAT"], target, sets, tmp_path)
    monkeypatch.setattr(target_log, "collect", None)
    again = recording.record(cell, METHODS["GAT"], target, sets, tmp_path)
    jax.tree.map(np.testing.assert_array_equal, again, logs)


def faked_main(out: str) -> int:
    """What processes that are killed often run: cells of no cost, so that kills fall on what a sweep writes."""
    agents, _ = policies.load(policies.shipped_path("InvertedPendulum", "MS"))
    sys.argv += ["--out", out]
    PRESETS["tiny"] = TINY

    def fake(cell, folder, quiet, threads):
        time.sleep(0.05)
        return outcome(cell, agents=agents)

    methods.run = fake
    return sweep.main()


def tiny_main(out: str | None = None):
    """What processes that are killed run: checkpoints after every iteration."""
    sys.argv += [] if out is None else ["--out", out]
    PRESETS["tiny"] = TINY
    policies.shipped = shipped
    original = training.loop.run
    often = {"seconds_between_checkpoints": 0.0}
    training.loop.run = lambda *args, **options: original(*args, **{**options, **often})
    if out is not None:
        return sweep.main()
    sys.exit(sweep.main())


@pytest.mark.slow
def test_a_sweep_killed_at_random_moments_ends_like_one_that_was_not(tmp_path):
    def start(out):
        code = "from tests.experiments import test_sweep; test_sweep.tiny_main()"
        options = ["--preset", "tiny", "--method", "MPGE+", "--samples", "11", "--out", str(out), "--quiet"]
        return subprocess.Popen(
            [sys.executable, "-c", code, *options],
            cwd=ROOT,
            env={**os.environ, "JAX_PLATFORMS": "cpu"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    started = time.monotonic()
    assert start(tmp_path / "whole").wait() == 0
    duration = time.monotonic() - started
    for kill in range(2):
        process = start(tmp_path / "killed")
        delay = random.uniform(0.3, 0.95) * duration
        print(f"kill {kill} after {delay:.2f} s")
        try:
            process.wait(delay)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    assert start(tmp_path / "killed").wait() == 0
    rows = []
    for name in ("whole", "killed"):
        found = json.loads((tmp_path / name / "results.json").read_text())["rows"]
        rows.append([{k: v for k, v in row.items() if "seconds" not in k} for row in found])
        assert len(rows[-1]) == 2
    assert rows[0] == rows[1]
    for file in ("transformers.npz", "curve.npz", "agents.npz"):
        with (
            np.load(tmp_path / "whole" / "cells" / "MPGE+-11" / file) as a,
            np.load(tmp_path / "killed" / "cells" / "MPGE+-11" / file) as b,
        ):
            assert a.files == b.files
            for name in set(a.files) - {"about"}:
                np.testing.assert_array_equal(a[name], b[name])


def test_two_sweeps_into_one_folder_are_refused(monkeypatch, capsys, tmp_path, faked):
    command = ("--preset", "tiny", "--method", "direct", "--out", tmp_path)
    with files.held(tmp_path):
        assert run(monkeypatch, *command) == 2
        said = capsys.readouterr().err.strip()
        assert said.startswith(f"sweep: {tmp_path} is in use by another run (process ") and "\n" not in said
        assert faked == []
    assert run(monkeypatch, *command) == 0 and not (tmp_path / ".lock").exists()
