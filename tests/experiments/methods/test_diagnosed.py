"""Simulators corrected by what a diagnosis names: whose log, which simulator, and what the rows say."""

import dataclasses
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from experiments import report
from experiments.methods import METHODS, diagnosed, grounded
from tests import small
from tests.experiments.tiny import assert_moves_like, work

BIAS = {"id": "actuator_bias", "form": "actuator_bias:reclipped", "at": "slide", "parameters": {"bias": 1.5}}


@pytest.fixture
def diagnoses(monkeypatch):
    """Diagnoses that name a bias where the policies of a log acted more than 30 times, and nothing elsewhere."""
    asked = []

    def diagnose(spec, recordings, config, progress):
        asked.append(sum(r.time.size for r in recordings))
        named = asked[-1] > 30
        return SimpleNamespace(
            verdict="effects" if named else "none",
            effects=lambda: {"effects": [BIAS] if named else []},
            seconds=2.0,
            to_json=lambda: {"verdict": "effects"},
        )

    monkeypatch.setattr(diagnosed, "diagnose", diagnose)
    return asked


def two_logs():
    """Of 40 rows, and of which 10 count."""
    long = small.log(size=2)
    return small.stacked(long, long.replace(count=jnp.array([5, 5], jnp.int32)))


def test_a_diagnosis_corrects_the_simulator_of_its_seed_and_falls_back_visibly(tmp_path, begun, diagnoses):
    given = work("diagnosed", tmp_path, seeds=(0, 1), logs=two_logs())
    made = METHODS["diagnosed"].work(given)
    assert_moves_like(begun[0], 1.5)
    assert_moves_like(begun[1], 0.0)
    assert [(row["verdict"], row["named"], row["simulator"]) for row in made.extra] == [
        ("effects", "actuator_bias at slide", "corrected"),
        ("none", "", "plain"),
    ]
    assert made.target_steps == [40, 10]
    assert jax.tree.leaves(made.learners)[0].shape[0] == 2
    # Made once, then read: each from its own log.
    again = METHODS["diagnosed"].work(given)
    assert len(diagnoses) == 2 and again.extra == made.extra


def test_a_diagnosis_takes_the_threads_that_its_cell_has(monkeypatch, tmp_path, begun):
    asked = []

    def diagnose(spec, recordings, config, progress):
        asked.append(config.jobs)
        return SimpleNamespace(
            verdict="none", effects=lambda: {"effects": []}, seconds=2.0, to_json=lambda: {}
        )

    monkeypatch.setattr(diagnosed, "diagnose", diagnose)
    METHODS["diagnosed"].work(work("diagnosed", tmp_path, logs=small.stacked(small.log(size=2)), threads=3))
    assert asked == [3]


def test_the_corrected_simulator_is_what_is_grounded(monkeypatch, tmp_path, begun, diagnoses):
    asked = []

    def ground(one):
        asked.append(one)
        curve = {"reward": np.full((3, 1, 1), float(len(asked)))}
        curve |= {} if one.truth is None else {"error_uniform": np.zeros((3, 1, 1))}
        return jax.tree.map(lambda x: x[None, None], small.constant(one.source, 0.5)), curve, [7]

    monkeypatch.setattr(grounded, "ground", ground)
    given = work("diagnosed+MPGE", tmp_path, seeds=(0, 1), logs=two_logs(), truth=lambda action: action)
    made = METHODS["diagnosed+MPGE"].work(given)
    assert_moves_like(begun[0], 2.0)
    assert_moves_like(begun[1], 0.5)
    # What changes actions in the corrected simulator is not what changes them in the plain one.
    assert [one.truth is None for one in asked] == [True, False]
    assert [row["grounding_simulator_steps"] for row in made.extra] == [7, 7]
    assert made.transformers.input_mean.shape == (2, 1, 5)
    # Both seeds' curves, of what is known of both.
    assert list(made.curve) == ["reward"] and made.curve["reward"].shape == (3, 2, 1)


def test_the_description_that_is_diagnosed_has_the_simulators_inertia(tmp_path):
    given = work("diagnosed", tmp_path)
    given = dataclasses.replace(given, cell=dataclasses.replace(given.cell, dynamics="legacy"))
    model = diagnosed._nominal(given).compile()
    legacy = envs.make("InvertedPendulum", "c", "legacy").model
    np.testing.assert_allclose(model.body_mass, legacy.body_mass)
    # Its cylinders are lighter than the capsules of today.
    assert model.body_mass.sum() < 0.95 * small.env("InvertedPendulum").model.body_mass.sum()


def test_the_table_says_what_was_named_and_where_nothing_was():
    rows = [
        {
            "task": "SkewedPendulum", "method": "diagnosed", "samples": 500, "seed": seed, "target_steps": 500,
            "return_stochastic": 1.0, "return_deterministic": 1.0, "verdict": verdict, "named": named,
            "simulator": "corrected" if named else "plain",
        }
        for seed, (verdict, named) in enumerate(
            (("effects", "actuator_bias at slide"), ("none", ""), ("unexplained", "armature at hinge"))
        )
    ]  # fmt: skip
    text = report.markdown(rows, list(METHODS), {})
    assert "| diagnosed | 500 | 0 | effects | actuator_bias at slide | corrected |" in text
    assert "| diagnosed | 500 | 1 | none | - | plain |" in text
    assert "| diagnosed | 500 | 2 | unexplained | armature at hinge | corrected |" in text
    old = [{name: row[name] for name in row if name not in ("verdict", "named", "simulator")} for row in rows]
    assert "What the diagnoses named" not in report.markdown(old, list(METHODS), {})
