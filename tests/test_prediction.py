"""How well a grounded simulator predicts the target, on rows kept back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax import prediction
from tests import small


def test_the_last_rows_of_every_policy_are_held_out():
    log = small.log()
    assert np.asarray(log.count).tolist() == [14, 13, 13]
    rest, rows = prediction.hold_out(log, 0.25)
    assert np.asarray(rest.count).tolist() == [10, 9, 9]
    assert np.asarray(rows).sum(axis=1).tolist() == [4, 4, 4]
    # Neither what remains nor padding.
    assert np.flatnonzero(np.asarray(rows)[1]).tolist() == [9, 10, 11, 12]
    np.testing.assert_array_equal(rest.observation, log.observation)


def test_a_log_of_one_row_keeps_it():
    rest, rows = prediction.hold_out(small.log(steps=3), 0.2)
    assert np.asarray(rest.count).tolist() == [1, 1, 1]
    assert not np.asarray(rows).any()


def test_the_truth_predicts_and_doing_nothing_does_not():
    env, log = small.env("InvertedPendulum"), small.log()
    rows = np.arange(log.observation.shape[1])[None] < np.asarray(log.count)[:, None]
    # The true change is +1.5 wherever it is not clipped.
    rows &= np.asarray(log.action)[..., 0] < 1.4
    judge = jax.jit(lambda pi_g, data, chosen: prediction.one_step_error(env, pi_g, data, chosen))
    truth, nothing = small.constant(env, 1.5), small.constant(env, 0.0)
    assert float(judge(truth, log, rows)) < 1e-3
    found = float(judge(nothing, log, rows))
    # The same by hand.
    observation, action = np.asarray(log.observation)[rows], np.asarray(log.action)[rows]
    following = np.asarray(log.next_observation)[rows]
    missed = small.step_from("InvertedPendulum", observation, action) - following
    expected = np.sqrt(np.mean(np.mean(missed**2, axis=0) / np.var(following - observation, axis=0)))
    assert found == pytest.approx(expected, rel=1e-3)
    # Rows that do not count may hold anything.
    spoilt = log.replace(observation=jnp.where(rows[..., None], log.observation, jnp.nan))
    assert float(judge(nothing, spoilt, rows)) == pytest.approx(found, rel=1e-5)
    # One that does is not good because it cannot be judged.
    lost = log.replace(observation=log.observation.at[0, np.flatnonzero(rows[0])[0]].set(jnp.nan))
    assert float(judge(nothing, lost, rows)) == np.inf
