"""How well a grounded simulator predicts the target, on rows kept back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.grounding import prediction
from tests import small


def test_the_last_rows_of_every_policy_are_held_out():
    log = small.log()
    assert np.asarray(log.count).tolist() == [14, 13, 13]
    rest, rows = prediction.hold_out(log, 0.25)
    assert np.asarray(rest.count).tolist() == [10, 9, 9]
    # Four of each: neither what remains nor padding.
    expected = np.concatenate(
        [np.asarray(log.observation)[k, last - 4 : last] for k, last in enumerate((14, 13, 13))]
    )
    np.testing.assert_array_equal(rows.observation[rows.weight > 0], expected)
    assert float(rows.weight.sum()) == 12
    np.testing.assert_array_equal(rest.observation, log.observation)


def test_many_held_out_rows_are_thinned_evenly():
    log = small.log()
    _, rows = prediction.hold_out(log, 0.25, most=6)
    _, every = prediction.hold_out(log, 0.25)
    np.testing.assert_array_equal(rows.weight, np.ones(6))
    np.testing.assert_array_equal(rows.action, every.action[:12:2])


def test_a_log_of_one_row_keeps_it():
    rest, rows = prediction.hold_out(small.log(steps=3), 0.2)
    assert np.asarray(rest.count).tolist() == [1, 1, 1]
    assert not np.asarray(rows.weight).any()


def test_the_truth_predicts_and_doing_nothing_does_not():
    env, log = small.env("InvertedPendulum"), small.log()
    valid = np.arange(log.observation.shape[1])[None] < np.asarray(log.count)[:, None]
    # The true change is +1.5 wherever it is not clipped.
    counts = (valid & (np.asarray(log.action)[..., 0] < 1.4)).reshape(-1)
    flat = jax.tree.map(
        lambda x: x.reshape(-1, x.shape[-1]), (log.observation, log.action, log.next_observation)
    )
    rows = prediction.HeldOut(*flat, jnp.asarray(counts, jnp.float32))
    judge = jax.jit(lambda pi_g, rows: prediction.one_step_error(env, pi_g, rows))
    truth, nothing = small.constant(env, 1.5), small.constant(env, 0.0)
    assert float(judge(truth, rows)) < 1e-3
    found = float(judge(nothing, rows))
    # The same by hand.
    observation, action, following = (np.asarray(x)[counts] for x in flat)
    missed = small.step_from("InvertedPendulum", observation, action) - following
    expected = np.sqrt(np.mean(np.mean(missed**2, axis=0) / np.var(following - observation, axis=0)))
    assert found == pytest.approx(expected, rel=1e-3)
    # Rows that do not count may hold anything.
    spoilt = rows.replace(observation=jnp.where(counts[:, None], rows.observation, jnp.nan))
    assert float(judge(nothing, spoilt)) == pytest.approx(found, rel=1e-5)
    # One that does is not good because it cannot be judged.
    lost = rows.replace(observation=rows.observation.at[np.flatnonzero(counts)[0]].set(jnp.nan))
    assert float(judge(nothing, lost)) == np.inf
