"""What each change of `Vine` brings: one at a time, and all of them."""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest

from experiments.tuning import trial, vine
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.discriminator import DiscriminatorConfig
from mpge_jax.grounding.transformer import TransformerConfig
from mpge_jax.learning.trpo import TRPOConfig

PAPER = vine.standard()["MPG-MS"]
VINE = vine.standard()["Vine"]


def test_all_changes_together_make_vine_of_the_papers_structure_and_back():
    assert reduce(lambda c, change: vine._with(c, VINE, change), vine.CHANGES, PAPER) == VINE
    assert reduce(lambda c, change: vine._with(c, PAPER, change), vine.CHANGES, VINE) == PAPER


@pytest.mark.parametrize("change", vine.CHANGES)
def test_a_variant_differs_in_its_change_alone(change):
    found = vine.variants(PAPER, VINE)
    with_it, without = found[f"MPG-MS with: {change}"], found[f"Vine without: {change}"]
    assert with_it != PAPER and without != VINE
    assert vine._with(with_it, PAPER, change) == PAPER and vine._with(without, VINE, change) == VINE


def test_every_variant_updates_from_as_many_transitions():
    assert {config.batch_size for config in vine.standard().values()} == {2048}


def test_a_trial_tells_the_errors_of_every_seed(monkeypatch):
    given = {}

    def ground(source, sets, logs, config, keys, truth, title):
        given.update(source=source.name, states=logs.observation.shape, keys=len(keys), title=title)
        curve = np.arange(20.0)[:, None] + np.array([0.0, 100.0])
        return None, {"error_uniform": curve, "error_own": 2 * curve}

    monkeypatch.setattr(trial.ensemble, "ground_ensemble", ground)
    config = GroundingConfig(
        num_envs=2, iterations=20, transformer=TransformerConfig(hidden=(4,)), policy=TRPOConfig(),
        discriminator=DiscriminatorConfig(hidden=(4,), next_as="residual"), value_minibatch=32,
    )  # fmt: skip
    found = trial.trial("SkewedPendulum", config, samples=10, seeds=2, title="a title", backend="c")
    assert given["source"] == "InvertedPendulum" and given["keys"] == 2 and given["title"] == "a title"
    assert given["states"][:3] == (2, 5, 2)  # seeds, policies, each one's share of the rows
    assert found["errors"] == {"0.25": [2.0, 102.0], "0.5": [7.0, 107.0], "1.0": [17.0, 117.0]}
    assert found["errors_own"]["1.0"] == [34.0, 234.0]
    assert found["iterations"] == 20 and found["simulator_steps"] == 20 * 2 * 32 * 2
    assert found["task"] == "SkewedPendulum" and found["samples"] == 10


def row(variant, samples, error):
    every = {"0.25": [3 * error], "0.5": [2 * error], "1.0": [error, 3 * error]}
    return {
        "variant": variant, "samples": samples, "simulator_steps": 2_304_000, "errors": every,
        "errors_own": every, "versions": {"machine": "a machine", "commit": "abc"},
    }  # fmt: skip


def test_the_page_has_a_line_for_each_result():
    page = vine.markdown([row("Vine", 500, 0.1), row("MPG-MS", 500, 0.2), row("Vine", 5000, 0.05)])
    assert (
        "| Vine | 2,304,000 | 0.200 (0.100 to 0.300) | 0.300 (0.300 to 0.300) | 0.200 (0.100 to 0.300) |"
        in page
    )
    assert page.index("## 500 target") < page.index("| MPG-MS |") < page.index("## 5,000 target")
    assert page.endswith("Machine: a machine, commit abc.\n") and "None has been run" not in page
    assert vine.markdown([]).endswith("run.\n\nNone has been run yet.\n")


def test_what_is_done_is_not_run_again_and_each_variant_has_its_configuration(tmp_path, monkeypatch, capsys):
    ran = []

    def run(task, config, samples, seeds, title, backend):
        ran.append((task, config, samples, backend))
        return {**row("", samples, 0.1), "title": title}

    monkeypatch.setattr(vine, "trial", run)
    monkeypatch.setattr(
        "sys.argv",
        ["vine", "--out", str(tmp_path), "--page", str(tmp_path / "vine.md"), "--samples", "500",
         "--backend", "c", "--variant", "MPG-MS", "Vine without: average of the iterates"],
    )  # fmt: skip
    assert vine.main() == 0 and vine.main() == 0
    assert ran == [
        ("BrokenCheetah", PAPER, 500, "c"),
        ("BrokenCheetah", replace(VINE, averaging=0.0), 500, "c"),
    ]
    assert (tmp_path / "vine.md").read_text() == vine.markdown(vine.stored(tmp_path))
    assert [r["title"] for r in vine.stored(tmp_path)] == [
        "Vine without: average of the iterates, 500 transitions",
        "MPG-MS, 500 transitions",
    ]


@pytest.mark.parametrize(("option", "value"), [("--variant", "Wine"), ("--backend", "d")])
def test_a_name_that_is_not_known_is_one_sentence(monkeypatch, capsys, option, value):
    monkeypatch.setattr("sys.argv", ["vine", option, value])
    with pytest.raises(SystemExit):
        vine.main()
    assert f"'{value}' is none of: " in capsys.readouterr().err
