"""Cells of a sweep: where agents are evaluated, and what a seed is said to have taken."""

import itertools
import json
import sys
from types import SimpleNamespace

import numpy as np

from experiments import methods, sweep
from experiments.methods import Cell, Outcome, training
from experiments.presets import PRESETS
from mpge_jax.rollouts import policies
from tests import small
from tests.experiments.tiny import TINY


def test_agents_are_evaluated_in_the_target(monkeypatch, tmp_path):
    monkeypatch.setattr(policies, "shipped", lambda task, *_: (small.policy_set(task), {}))
    found = []

    def evaluate(cell, env, agents):
        found.append((env.name, agents.size))
        return {"return_stochastic": np.array([[1.0, 3.0], [5.0, 5.0]])}

    monkeypatch.setattr(training, "evaluate", evaluate)
    outcome = methods.run(Cell("SkewedPendulum", "direct", 0, (0, 1), TINY, "c", "mujoco"), tmp_path)
    assert found == [("SkewedPendulum", 2)]
    assert [row["return_stochastic"] for row in outcome.rows] == [2.0, 5.0]
    assert [row["return_stochastic_std"] for row in outcome.rows] == [1.0, 0.0]


def test_seconds_of_a_cell_are_shared_by_its_seeds(monkeypatch, tmp_path):
    monkeypatch.setitem(PRESETS, "tiny", TINY)
    clock = itertools.count(0.0, 30.0)
    monkeypatch.setattr(sweep, "time", SimpleNamespace(monotonic=lambda: next(clock)))

    def run(cell, folder, quiet, threads):
        rows = [
            {
                "task": cell.task, "method": cell.method, "samples": cell.samples, "seed": seed, "target_steps": 0,
                "return_stochastic": 1.0, "return_deterministic": 1.0,
            }
            for seed in cell.seeds
        ]  # fmt: skip
        return Outcome(rows, 12.0, {}, None, small.policy_set())

    monkeypatch.setattr(methods, "run", run)
    command = ["sweep", "--preset", "tiny", "--method", "direct", "--seeds", "3", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", command)
    assert sweep.main() == 0
    rows = json.loads((tmp_path / "results.json").read_text())["rows"]
    assert [(row["seconds"], row["grounding_seconds"]) for row in rows] == [(10.0, 4.0)] * 3
    assert not any("resumed" in row for row in rows)
    result = tmp_path / "cells" / "direct-0" / "result.json"
    result.unlink()
    (result.parent / "grounding").mkdir()
    assert sweep.main() == 0
    rows = json.loads((tmp_path / "results.json").read_text())["rows"]
    assert all(row["resumed"] for row in rows)
