"""Grounding that is judged by rows kept back: the best is kept, whichever it is, and the run ends."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mpge_jax
from mpge_jax.grounding import adversarial, early_stop, transformer
from mpge_jax.grounding.early_stop import EarlyStop
from mpge_jax.learning.trpo import TRPOConfig
from tests import points

STOP = EarlyStop(share=0.25, rows=8, patience=2)


def shifted(by: float) -> transformer.Transformer:
    """A transformer without hidden layers that adds `by`."""
    made = transformer.init(jax.random.key(0), 1, 1, transformer.TransformerConfig(hidden=()))
    (layer,) = made.params["mean"]["params"].values()
    mean = {"params": {"Dense_0": {"kernel": 0.0 * layer["kernel"], "bias": jnp.array([by])}}}
    return made.replace(params={**made.params, "mean": mean})


def bias(params) -> float:
    return float(params["mean"]["params"]["Dense_0"]["bias"][0])


def test_the_better_one_is_kept_whichever_it_is():
    config = dataclasses.replace(points.CONFIG, transformer=transformer.TransformerConfig(hidden=()))
    learned_from, rows = STOP.hold_out(points.log())

    def begin(by):
        return early_stop.init(
            adversarial.init(
                jax.random.key(0), points.SOURCE, points.policies(), learned_from, config, shifted(by)
            ),
            points.SOURCE,
            rows,
        )

    def moved(state, by):
        inner = state.grounding
        params = shifted(by).params
        return inner.replace(policy=inner.policy.replace(params=params), average=params)

    state = begin(0.2)
    assert float(state.error) > 0.1
    state, metrics = early_stop.update(state, moved(state, 0.5), points.SOURCE, rows)
    assert (bias(state.best), int(state.stale)) == (pytest.approx(0.5), 0)
    assert float(state.error) < 1e-5 and float(metrics["held_out_error"]) < 1e-5
    for turn in (1, 2):
        state, metrics = early_stop.update(state, moved(state, 0.6), points.SOURCE, rows)
        assert (bias(state.best), int(state.stale)) == (pytest.approx(0.5), turn)
        # Where it stands is told apart from the best so far, and is gone on from.
        assert bias(state.grounding.result.params) == pytest.approx(0.6)
        assert float(metrics["held_out_error"]) > 0.05 > float(metrics["held_out_best"])
    assert bias(state.result.params) == pytest.approx(0.5)
    lost, _ = early_stop.update(state, moved(state, jnp.nan), points.SOURCE, rows)
    assert bias(lost.result.params) == pytest.approx(0.5)


def test_a_run_ends_when_all_members_have_been_stale_for_so_long():
    over = lambda *stale: STOP.is_over({"held_out_stale": np.array(stale)})  # noqa: E731
    assert over(2, 3) and not over(1, 9)


def test_rows_held_out_are_not_learned_from():
    learned_from, rows = STOP.hold_out(points.log())
    assert np.asarray(learned_from.count).tolist() == [15, 15, 15]
    held = set(np.asarray(rows.observation)[:, 0].tolist())
    valid = np.arange(20)[None] < np.asarray(learned_from.count)[:, None]
    assert len(held) == 8 and not held & set(np.asarray(learned_from.observation)[valid][:, 0].tolist())


def test_a_start_that_is_the_truth_survives_adversarial_grounding():
    config = dataclasses.replace(
        points.CONFIG,
        iterations=40,
        transformer=transformer.TransformerConfig(hidden=()),
        policy=TRPOConfig(max_kl=0.05),
    )
    best, curve = mpge_jax.ground(
        points.SOURCE,
        points.policies(),
        points.log(),
        config,
        jax.random.key(0),
        start=shifted(points.SHIFT),
        stopping=STOP,
        truth=points.truth,
        quiet=True,
    )
    # Two iterations without a better one, and it is over; the truth cannot be bettered.
    assert curve["held_out_stale"].tolist() == [1, 2]
    assert bias(best.params) == pytest.approx(points.SHIFT)
    assert curve["error_uniform"][-1] < 1e-6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"share": 0.0}, r"share must lie in \(0, 1\), got 0.0"),
        ({"share": 1.0}, r"share must lie in \(0, 1\), got 1.0"),
        ({"rows": 0}, "rows must be at least 1, got 0"),
        ({"patience": 0}, "patience must be at least 1, got 0"),
    ],
)
def test_a_configuration_out_of_range_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(STOP, **change)
