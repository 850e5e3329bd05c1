"""Values of K rollout policies: each head learns from its own rows, and only from those."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax import value
from mpge_jax.value import ValueConfig

SEPARATE = ValueConfig(policies=3, hidden=(16,), learning_rate=1e-2, epochs=5, minibatch_size=48)
ONE_HOT = dataclasses.replace(SEPARATE, heads="one_hot")
ROWS = 192
update = jax.jit(value.update, static_argnames="config")


def batch(seed=0):
    """Policy k earns `(k - 1) x_0` at x: the same input is worth something else under each policy."""
    inputs = jax.random.normal(jax.random.key(seed), (ROWS, 2))
    policy = jnp.arange(ROWS) % 3
    return inputs, policy, (policy - 1.0) * inputs[:, 0]


@pytest.mark.parametrize("config", [SEPARATE, ONE_HOT])
def test_learns_the_reward_of_each_policy(config):
    def step(state, key):
        return value.update(state, *batch(), key, config)

    state = value.init(jax.random.key(0), 2, config)
    keys = jax.random.split(jax.random.key(1), 60)
    state, metrics = jax.jit(lambda s: jax.lax.scan(step, s, keys))(state)
    assert float(metrics["value_loss"][-1]) < 0.02 < float(metrics["value_loss"][0])
    assert float(metrics["explained_variance"][-1]) > 0.95
    at = jnp.full((3, 2), 0.5)
    np.testing.assert_allclose(
        value.predict(state.params, at, jnp.arange(3), config), [-0.5, 0.0, 0.5], atol=0.12
    )


@pytest.mark.parametrize("config", [SEPARATE, ONE_HOT])
def test_metrics_by_hand(config):
    # One epoch of one minibatch that is the whole batch: the loss is that of the values before the update.
    config = dataclasses.replace(config, epochs=1, minibatch_size=ROWS)
    inputs, policy, returns = batch()
    state = value.init(jax.random.key(0), 2, config)
    _, metrics = update(state, inputs, policy, returns, jax.random.key(1), config)
    error = np.asarray(returns - value.predict(state.params, inputs, policy, config))
    assert float(metrics["value_loss"]) == pytest.approx((error**2).mean(), rel=1e-4)
    expected = 1 - error.var() / np.asarray(returns).var()
    assert float(metrics["explained_variance"]) == pytest.approx(expected, rel=1e-4)


def test_heads_share_nothing():
    inputs, policy, returns = batch()
    state = value.init(jax.random.key(0), 2, SEPARATE)
    after, _ = update(state, inputs, policy, returns, jax.random.key(1), SEPARATE)
    spoilt = jnp.where(policy == 2, 100.0, returns)
    other, _ = update(state, inputs, policy, spoilt, jax.random.key(1), SEPARATE)
    for a, b in zip(jax.tree.leaves(after.params), jax.tree.leaves(other.params), strict=True):
        np.testing.assert_array_equal(a[:2], b[:2])
        assert not np.array_equal(a[2], b[2])


@pytest.mark.parametrize("rows_of_last", [0, 1])
def test_a_policy_with_few_rows(rows_of_last):
    inputs, _, returns = batch()
    policy = jnp.arange(ROWS) % 2
    policy = policy.at[:rows_of_last].set(2)
    state = value.init(jax.random.key(0), 2, SEPARATE)
    after, metrics = update(state, inputs, policy, returns, jax.random.key(1), SEPARATE)
    again, _ = update(after, inputs, policy, returns, jax.random.key(2), SEPARATE)
    moved = [
        not np.array_equal(a[2], b[2])
        for a, b in zip(jax.tree.leaves(again.params), jax.tree.leaves(state.params), strict=True)
    ]
    assert any(moved) == (rows_of_last > 0)
    assert bool(jnp.isfinite(metrics["value_loss"]))


def test_every_network_draws_its_own_rows():
    # 4, 1 and 7 rows, shares of 2: two steps an epoch.
    head = jnp.array([2, 0, 2, 1, 2, 0, 2, 0, 2, 2, 0, 2])
    config = dataclasses.replace(SEPARATE, epochs=3, minibatch_size=6)
    counts = jnp.array([4.0, 1.0, 7.0])
    indices = np.asarray(value._indices_by_head(jax.random.key(0), head, counts, config))
    assert indices.shape == (6, 3, 2)
    for k in range(3):
        assert set(np.asarray(head)[indices[:, k].ravel()]) == {k}
    for epoch in indices.reshape(3, 2, 3, 2):
        assert len(set(epoch[:, 0].ravel())) == 4  # all four rows once
        assert len(set(epoch[:, 2].ravel())) == 4  # four of seven, none twice


@pytest.mark.parametrize("config", [SEPARATE, ONE_HOT])
def test_vmap_equals_separate_runs(config):
    members = [(value.init(jax.random.key(i), 2, config), *batch(i), jax.random.key(i)) for i in range(2)]
    run = partial(value.update, config=config)
    together = jax.jit(jax.vmap(run))(*jax.tree.map(lambda *x: jnp.stack(x), *members))
    alone = [update(*member, config) for member in members]
    compare = partial(np.testing.assert_allclose, rtol=1e-3, atol=1e-5)
    jax.tree.map(compare, together, jax.tree.map(lambda *x: np.stack(x), *alone))


@pytest.mark.parametrize(
    ("name", "wrong"), [("policies", 0), ("epochs", 0), ("learning_rate", 0.0), ("heads", "onehot")]
)
def test_configuration_is_checked(name, wrong):
    with pytest.raises(ValueError, match=f"ValueConfig: {name} must be"):
        dataclasses.replace(SEPARATE, **{name: wrong})
