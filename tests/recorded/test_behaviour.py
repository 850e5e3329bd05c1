"""What acted in a log, from the log alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.recorded import behaviour as module
from mpge_jax.recorded.behaviour import behaviour
from mpge_jax.rollouts.target_log import TargetLog
from tests import small


def log_of(observation, action, count) -> TargetLog:
    rows = observation.shape[:2]
    return TargetLog(
        observation, action, observation, jnp.zeros(rows), jnp.zeros(rows, jnp.int32), jnp.asarray(count)
    )


def one(tree, k: int):
    return jax.tree.map(lambda x: x[k], tree)


def test_each_part_does_what_it_did_nearby_and_padding_does_nothing():
    # Part 0 has four states on a line, part 1 two; numbers differ in size by a thousand.
    line = jnp.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [9.0, 1000.0]])
    observation = jnp.stack([line, line + 7.0])
    action = jnp.arange(8.0).reshape(2, 4, 1)
    made = behaviour(log_of(observation, action, [4, 2]))
    ask = jax.jit(jax.vmap(module.act, (None, None, 0)))
    keys = jax.random.split(jax.random.key(0), 200)
    near = np.asarray(ask(one(made.params, 0), jnp.array([0.1, 3.0]), keys))
    assert sorted(set(near.ravel().tolist())) == [0.0, 1.0, 2.0]
    counts = np.unique(near, return_counts=True)[1]
    assert counts.min() > 40
    few = np.asarray(ask(one(made.params, 1), jnp.array([9.0, 7.0]), keys))
    assert np.unique(few).tolist() == [4.0, 5.0] and 60 < (few == 4.0).sum() < 140


def test_long_logs_are_thinned_evenly(monkeypatch):
    monkeypatch.setattr(module, "MOST", 5)
    observation = jnp.arange(20.0).reshape(1, 20, 1)
    made = behaviour(log_of(observation, observation, [20]))
    np.testing.assert_allclose(made.params.action[0, :, 0], [0, 4, 8, 12, 16])


def test_it_fits_the_environments_that_logs_are_of():
    made = behaviour(small.log())
    assert made.size == 3
    made.check_fits(small.env("SkewedPendulum"))
    with pytest.raises(ValueError, match="cannot act on the 11 observations of Hopper"):
        made.check_fits(small.env("Hopper"))
