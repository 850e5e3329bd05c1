"""Sweeps from recordings alone: nothing acts in a target, what was held out judges, and policies can be loaded."""

import json
import sys
from dataclasses import replace

import jax
import numpy as np
import pytest

import envs
from experiments import methods, sweep
from experiments.methods import METHODS, LogFiles, logged
from experiments.presets import PRESETS
from experiments.results import page as results
from mpge_jax.grounding import prediction
from mpge_jax.rollouts import policies
from tests import small
from tests.experiments.test_sweep import shipped
from tests.experiments.tiny import TINY, work
from tests.recorded.logs import of_target_log, swing


@pytest.fixture
def log(tmp_path, monkeypatch):
    """A folder of recordings of SkewedPendulum, and the tiny preset."""
    monkeypatch.setitem(PRESETS, "tiny", TINY)
    monkeypatch.setattr(policies, "shipped", shipped)
    (tmp_path / "log").mkdir()
    return of_target_log(tmp_path / "log")


def run(monkeypatch, *arguments) -> int:
    command = ["sweep", "--task", "InvertedPendulum", "--preset", "tiny", "--backend", "c", "--quiet"]
    monkeypatch.setattr(sys, "argv", [*command, *map(str, arguments)])
    return sweep.main()


def test_policies_and_errors_come_from_the_log_and_nothing_is_run_in_a_target(
    monkeypatch, tmp_path, log, capsys, begun
):
    made, make = [], envs.make
    monkeypatch.setattr(envs, "make", lambda name, *a, **k: made.append(name) or make(name, *a, **k))
    out = tmp_path / "out"
    command = ("--target-log", log, "--method", "GAT", "--out", out)
    assert run(monkeypatch, *command, "--samples", 14, "--seeds", 2) == 0
    assert set(made) == {"InvertedPendulum"}
    rows = json.loads((out / "results.json").read_text())["rows"]
    assert [(row["method"], row["samples"], row["target_steps"]) for row in rows] == [("GAT", 14, 14)] * 2
    for row in rows:
        assert not any(name.startswith("return") for name in row)
        assert row["simulator_error"] > 0.05 and np.isfinite(row["held_out_error"])
    table = (out / "results.md").read_text()
    assert "nothing was run in the target" in table and "`cells/GAT-14/policy`" in table
    assert not (out / "returns.png").exists()
    said = capsys.readouterr().err
    assert "not possible from a log: direct, DR, finetune, target" in said and "14 as it was made" not in said
    policy = policies.controller(out / "cells" / "GAT-14" / "policy", 1)
    kept, _ = policies.load(out / "cells" / "GAT-14" / "agents.npz")
    observation = jax.numpy.array([0.1, -0.05, 0.2, 0.3])
    expected = jax.vmap(lambda actor: policies.sac.act(actor, observation))(kept.actor)[1]
    np.testing.assert_allclose(policy(observation), expected, atol=1e-2)
    # The same log goes on where it was; another is another sweep.
    assert run(monkeypatch, *command, "--samples", 14, "--seeds", 2) == 0
    assert "done before" in capsys.readouterr().err
    np.savez(log / "more.npz", **swing())
    logged.read.cache_clear()
    assert run(monkeypatch, *command, "--samples", 14, "--seeds", 2) == 2
    assert "holds another sweep (target_log differ)" in capsys.readouterr().err
    with pytest.raises(ValueError, match="was made from a recorded log and has no returns"):
        results.read_sweep(out)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--method", "direct"],
            "--method direct learns nothing from a log, and there is no target to act in",
        ),
        (["--method", "SPG", "target"], "--method target learns nothing from a log"),
        (
            ["--task", "SkewedPendulum"],
            "--task SkewedPendulum is a simulated target; with --target-log it names",
        ),
        (["--samples", "5000"], "--samples 5000 is more than the log has to learn from: "),
        (["--map", "nowhere.yaml"], "--target-log: cannot read the map"),
        (["--target-log", "nowhere.npz"], "--target-log: the recording "),
    ],
)
def test_what_cannot_be_done_with_a_log_is_one_sentence(
    monkeypatch, tmp_path, log, capsys, arguments, message
):
    given = arguments if arguments[0] == "--target-log" else ["--target-log", log, *arguments]
    assert run(monkeypatch, "--out", tmp_path / "out", *given) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith(f"sweep: {message}") and "\n" not in said
    assert not (tmp_path / "out").exists()


def test_options_of_a_log_ask_for_one(monkeypatch, tmp_path, capsys):
    assert (
        run(
            monkeypatch,
            "--task",
            "SkewedPendulum",
            "--preset",
            "quick",
            "--model",
            "m.xml",
            "--out",
            tmp_path / "out",
        )
        == 2
    )
    assert "give it with --target-log" in capsys.readouterr().err


def test_every_method_from_a_log_says_how_its_simulator_predicts(tmp_path, log, begun):
    """Each method's error is that of the simulator that it made, on what it never saw."""
    files = LogFiles((log,))
    held = logged.held_out(logged.read(files, "InvertedPendulum").held)
    source = small.env("InvertedPendulum")
    given = float(prediction.error_under(source, held, held.action))
    right = float(prediction.one_step_error(source, small.constant(source, 1.5), held))
    assert given > 0.1 and right < 1e-2, "SkewedPendulum pushes by 1.5"
    cell = methods.Cell("InvertedPendulum", "delta", 14, (0, 1), TINY, "c", "mujoco", files)
    logs, acted = logged.part_of(cell, METHODS["delta"], "InvertedPendulum")
    assert logs.count.tolist() == [[7, 7]] * 2 and acted.params.action.shape == (2, 2, 7, 1)
    at = work("delta", tmp_path, seeds=(0, 1), samples=14, logs=logs)
    at = replace(at, target=None, behaviour=acted, held_out=held)
    assert [set(row) for row in METHODS["delta"].work(at).extra] == [
        {"grounding_simulator_steps", "held_out_error"}
    ] * 2
    one = at.only(1)
    assert one.behaviour.params.action.shape[0] == 1
    assert (
        logged.in_logged_states(at, TINY.tasks["InvertedPendulum"].grounding).restart_steps
        == logged.LOGGED_STEPS
    )
    with pytest.raises(AssertionError):
        _ = at.live_target
