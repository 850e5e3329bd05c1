"""The heat map of a sweep: every transformer along every rollout policy."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.results import heat_map
from experiments.results import page as results
from experiments.storage import SweepFolder, plain
from mpge_jax.grounding import transform_error
from mpge_jax.rollouts import policies
from tests import small
from tests.experiments.tiny import TINY


def row(seed: int) -> dict:
    return {
        "task": "SkewedPendulum", "method": "MPGE-MS", "samples": 500, "seed": seed, "target_steps": 500,
        "return_stochastic": 1.0, "return_deterministic": 1.0, "seconds": 1.0, "grounding_seconds": 1.0,
    }  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A sweep whose first seed has learned the truth and nothing, and its second one the other way round."""
    monkeypatch.setattr(policies, "shipped", lambda task, *_: (small.policy_set(task, size=2), {}))
    identity = plain(
        {"task": "SkewedPendulum", "seeds": 2, "preset": TINY, "backend": "c", "dynamics": "mujoco"}
    )
    sweep = SweepFolder(tmp_path / "sweep", identity)
    env = small.env("InvertedPendulum")
    right, wrong = small.constant(env, 1.5), small.constant(env, 0.0)
    made = small.stacked(small.stacked(right, wrong), small.stacked(wrong, right))
    sweep.save_cell("MPGE-MS", 500, [row(0), row(1)], {}, made, small.policy_set("InvertedPendulum", size=2))
    sweep.write_tables("")
    return sweep.path


def test_transformers_come_back_as_they_were_saved(folder: Path):
    sweep = SweepFolder(folder, json.loads((folder / "sweep.json").read_text())["identity"])
    made = sweep.transformers("MPGE-MS", 500)
    env = small.env("InvertedPendulum")
    one = jax.tree.map(lambda x: x[1, 1], made)
    jax.tree.map(np.testing.assert_array_equal, one, small.constant(env, 1.5))
    assert sweep.transformers("direct", 0) is None


def test_every_transformer_is_tried_along_every_policy(folder: Path):
    record = heat_map.measured(folder, steps=64)
    errors = np.array(record["cells"]["MPGE-MS-500"])
    assert errors.shape == (2, 2, 2)
    np.testing.assert_allclose([errors[0, 0], errors[1, 1]], 0.0, atol=1e-5)
    # Doing nothing: 1.5 but where the pendulum's limit cuts it off.
    assert (errors[0, 1] > 0.3).all() and (errors[0, 1] <= 1.5 + 1e-5).all()
    heat_map.draw(record, folder / "heat_map.png")
    (folder / "heat_map.json").write_text(json.dumps(record))
    text = results.page(results.Args((folder,), folder.parent / "docs" / "results.md"))
    assert (
        "along 64 steps of each rollout policy in" in text
        and "SPG recorded" not in text
        and "sweep-heat_map.png" in text
    )
    means = " | ".join(f"{x:.3f}" for x in errors.mean(axis=(0, 1)))
    assert f"| MPGE-MS-500 | {means} | {errors.min():.3f}, {errors.max():.3f} |" in text


def test_the_policys_own_actions_are_those_that_are_judged():
    """Of a policy that always pushes with 0.4, doing nothing misses 1.5 exactly; with 2.9, the limit leaves 0.1."""
    env, truth = small.env("InvertedPendulum"), transform_error.truth_of(small.env("SkewedPendulum"))
    idle = small.constant(env, 0.0)
    for push, missed in ((0.4, 1.5), (2.9, 0.1)):
        act = lambda obs, key, push=push: jnp.full((obs.shape[0], 1), push)  # noqa: E731
        error = transform_error.in_rollouts(jax.random.key(0), idle, env, truth, 64, act)
        assert float(error) == pytest.approx(missed, abs=1e-5)


def test_a_target_without_a_true_transformation_is_refused(folder: Path, monkeypatch, capsys):
    record = json.loads((folder / "sweep.json").read_text())
    record["identity"]["task"] = "HeavyCheetah"
    (folder / "sweep.json").write_text(json.dumps(record))
    monkeypatch.setattr("sys.argv", ["heat_map", str(folder)])
    assert heat_map.main() != 0
    assert "HeavyCheetah differs from HalfCheetah otherwise than by its actions" in capsys.readouterr().err
    assert not (folder / "heat_map.json").exists()
