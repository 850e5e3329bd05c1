"""Returns of a sweep's agents in the simulators that they were trained in."""

import json
from pathlib import Path

import jax
import pytest

from experiments.results import grounded_returns
from experiments.results import page as results
from experiments.storage import SweepFolder, plain
from mpge_jax.learning import agent
from tests import small
from tests.experiments.tiny import TINY

EPISODES = 64


def row(seed: int, method: str = "MPGE-MS", samples: int = 500) -> dict:
    return {
        "task": "SkewedPendulum", "method": method, "samples": samples, "seed": seed, "target_steps": 500,
        "return_stochastic": 3.0 + 4.0 * seed, "return_deterministic": 1.0, "seconds": 1.0,
    }  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A sweep whose first seed's transformers are right and whose second seed's do nothing."""
    identity = plain(
        {"task": "SkewedPendulum", "seeds": 2, "preset": TINY, "backend": "c", "dynamics": "mujoco"}
    )
    sweep = SweepFolder(tmp_path / "sweep", identity)
    env = small.env("InvertedPendulum")
    right, idle = small.constant(env, 1.5), small.constant(env, 0.0)
    made = small.stacked(small.stacked(right, right), small.stacked(idle, idle))
    agents = small.policy_set("InvertedPendulum", size=2)
    sweep.save_cell("MPGE-MS", 500, [row(0), row(1)], {}, made, agents)
    sweep.save_cell("direct", 0, [row(s, "direct", 0) for s in (0, 1)], {}, None, agents)
    sweep.write_tables("")
    return sweep.path


def test_right_transformers_give_the_targets_returns_and_idle_ones_the_simulators(folder: Path):
    cells = grounded_returns.measured(folder, EPISODES)["cells"]
    # `direct` has agents, and no grounded simulator
    assert list(cells) == ["MPGE-MS-500"]
    found = cells["MPGE-MS-500"]
    agents, target = small.policy_set("InvertedPendulum", size=2), small.env("SkewedPendulum")
    first = jax.tree.map(lambda x: x[0], agents.actor)
    there = float(agent.evaluate(jax.random.key(3), target, first, EPISODES, True).mean())
    assert found["grounded"][0] == pytest.approx(there, rel=0.15)
    assert abs(found["simulator"][0] / there - 1.0) > 0.3
    assert found["grounded"][1] == pytest.approx(found["simulator"][1], rel=0.15)
    # doing nothing misses 1.5 where the limit of the action does not cut that off
    assert found["error"][0] == pytest.approx(0.0, abs=1e-5) and 0.5 < found["error"][1] <= 1.5


def test_the_page_sets_them_beside_the_target(folder: Path, capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["grounded_returns", str(folder), "--episodes", "2"])
    assert grounded_returns.main() == 0
    record = json.loads((folder / "grounded_returns.json").read_text())
    found = {"simulator": [10.0, 20.0], "grounded": [40.0, 40.0]}
    record["cells"]["MPGE-MS-500"] = {**found, "error": [0.1, 0.3]}
    (folder / "grounded_returns.json").write_text(json.dumps(record))
    text = results.page(results.Args((folder,), folder.parent / "docs" / "results.md"))
    assert "2 episodes each" in text and "| MPGE-MS-500 | 15 ± 7 | 40 ± 0 | 5 ± 3 | 0.200 ± 0.141 |" in text
    # of a target that is no change of actions no error is known
    record["cells"]["MPGE-MS-500"] = found
    (folder / "grounded_returns.json").write_text(json.dumps(record))
    text = results.page(results.Args((folder,), folder.parent / "docs" / "results.md"))
    assert "| MPGE-MS-500 | 15 ± 7 | 40 ± 0 | 5 ± 3 |\n" in text
    (folder / "grounded_returns.json").write_text("{}")
    with pytest.raises(ValueError, match="not what grounded_returns writes"):
        results.page(results.Args((folder,), folder.parent / "docs" / "results.md"))


def test_a_sweep_without_transformers_is_refused(folder: Path, monkeypatch, capsys):
    (folder / "cells" / "MPGE-MS-500" / "transformers.npz").unlink()
    monkeypatch.setattr("sys.argv", ["grounded_returns", str(folder)])
    assert grounded_returns.main() == 2
    assert "no cell" in capsys.readouterr().err
