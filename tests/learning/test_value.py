"""Values of K rollout policies: each head learns from its own rows, and only from those."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.learning import value
from mpge_jax.learning.value import ValueConfig

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


def test_every_network_goes_through_all_its_own_rows_once_an_epoch():
    # 5, 1, 0 and 8 rows in minibatches of 3: 2, 1, 0 and 3 turns an epoch.
    head = jnp.array([3, 0, 3, 1, 3, 0, 3, 0, 3, 3, 0, 3, 3, 0])
    config = ValueConfig(policies=4, epochs=3, minibatch_size=3)
    plan = value._plan(jax.random.key(0), head, config)
    assert plan.turns.tolist() == [6, 3, 0, 9]
    used = {}
    for number in range(9):
        epochs, rows, weight = (np.asarray(x) for x in plan.minibatches(jnp.int32(number)))
        for network in np.flatnonzero(number < np.asarray(plan.turns)):
            used.setdefault((network, epochs[network]), []).extend(rows[network][weight[network] > 0])
    own = {network: np.flatnonzero(np.asarray(head) == network).tolist() for network in (0, 1, 3)}
    assert {of: sorted(rows) for of, rows in used.items()} == {
        (network, epoch): rows for network, rows in own.items() for epoch in range(3)
    }
    assert len({tuple(used[0, epoch]) for epoch in range(3)}) == 3


def test_shuffles_are_those_of_a_stable_sort():
    head = jax.random.randint(jax.random.key(0), (2048,), 0, 3)
    plan = value._plan(jax.random.key(1), head, SEPARATE)
    for epoch, key in enumerate(jax.random.split(jax.random.key(1), SEPARATE.epochs)):
        drawn = head + 0.5 * jax.random.uniform(key, head.shape)
        np.testing.assert_array_equal(plan.order[epoch], jnp.argsort(drawn))


def test_the_optimiser_of_an_absent_policy_rests():
    inputs, policy, returns = batch()
    state = value.init(jax.random.key(0), 2, SEPARATE)
    state, _ = update(state, inputs, policy, returns, jax.random.key(1), SEPARATE)
    without, _ = update(state, inputs, jnp.arange(ROWS) % 2, returns, jax.random.key(2), SEPARATE)
    for before, after in zip(jax.tree.leaves(state), jax.tree.leaves(without), strict=True):
        np.testing.assert_array_equal(before[2], after[2])
    # Adam counts the steps of each network by itself: 64 rows in two minibatches, and 96, five times.
    assert np.asarray(state.optimiser[0].count).tolist() == [10, 10, 10]
    assert np.asarray(without.optimiser[0].count).tolist() == [20, 20, 10]


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
