"""PPO: the clipped objective by hand, the shared batch helpers, the whole on a bandit with a known answer."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from mpge_jax.grounding import transformer
from mpge_jax.learning import ppo
from mpge_jax.learning.distributions import gaussian_log_prob
from mpge_jax.learning.policy_gradient import PolicyBatch, minibatch_indices, standardise
from tests.learning import bandit

update = jax.jit(ppo.update, static_argnames=("distribution", "config"))


def test_clipped_objective_by_hand():
    ratio = jnp.array([1.5, 1.5, 0.5, 0.5, 1.1, 0.9])
    advantage = jnp.array([1.0, -1.0, 1.0, -1.0, 2.0, -2.0])
    # Gains are capped at 1.2 and at -0.8, losses never are; inside the clip it is ratio * advantage.
    expected = [1.2, -1.5, 0.5, -0.8, 2.2, -1.8]
    np.testing.assert_allclose(ppo.clipped_objective(ratio, advantage, 0.2), expected, rtol=1e-6)


def test_gradient_vanishes_beyond_the_clip():
    slope = jax.vmap(jax.grad(lambda r, a: ppo.clipped_objective(r, a, 0.2)))
    ratio = jnp.array([1.5, 1.5, 0.5, 0.5])
    np.testing.assert_allclose(slope(ratio, jnp.array([1.0, -1.0, 1.0, -1.0])), [0.0, -1.0, 1.0, 0.0])


def test_one_full_batch_step_is_adam_on_the_policy_gradient():
    params = bandit.policy_params(jax.random.key(0))
    batch = bandit.batch(params, jax.random.key(1), 32)
    config = ppo.PPOConfig(epochs=1, minibatch_size=32, learning_rate=1e-2, max_gradient_norm=1e6)
    state, metrics = update(ppo.init(params, config), batch, jax.random.key(2), transformer.apply, config)
    # At ratio 1 nothing is clipped and the gradient of the ratio is that of the log-probability.
    advantages = (batch.advantages - batch.advantages.mean()) / batch.advantages.std()

    def objective(p):
        log_prob = gaussian_log_prob(batch.actions, *transformer.apply(p, batch.inputs))
        return jnp.mean(log_prob * advantages)

    gradient = jax.grad(objective)(params)
    assert float(metrics["gradient_norm"]) == pytest.approx(float(optax.tree.norm(gradient)), rel=1e-4)
    # Adam's first step has length lr along the sign of every gradient that is well above its epsilon.
    for new, old, slope in zip(*map(jax.tree.leaves, (state.params, params, gradient)), strict=True):
        clear = np.abs(slope) > 1e-5
        np.testing.assert_allclose(
            np.asarray(new - old)[clear], 1e-2 * np.sign(np.asarray(slope)[clear]), rtol=5e-3
        )


def test_metrics_describe_the_update():
    params = bandit.policy_params(jax.random.key(0))
    batch = bandit.batch(params, jax.random.key(1), 256)
    config = ppo.PPOConfig(epochs=10, minibatch_size=64, learning_rate=3e-2)
    state, metrics = update(ppo.init(params, config), batch, jax.random.key(2), transformer.apply, config)
    log_prob = gaussian_log_prob(batch.actions, *transformer.apply(state.params, batch.inputs))
    ratio = jnp.exp(log_prob - batch.log_probs)
    assert float(metrics["kl"]) == pytest.approx(float(jnp.mean(ratio - 1 - jnp.log(ratio))), rel=1e-3)
    beyond = np.mean(np.abs(np.asarray(ratio) - 1) > 0.2)
    assert 0 < beyond < 1
    assert float(metrics["clip_fraction"]) == pytest.approx(beyond, abs=1e-6)
    gained = ppo.clipped_objective(ratio, standardise(batch.advantages), 0.2).mean()
    assert float(metrics["improvement"]) == pytest.approx(float(gained), abs=1e-5)
    assert float(gained) > 0


def test_bandit_is_solved():
    config = ppo.PPOConfig(learning_rate=3e-3, epochs=4, minibatch_size=128)
    state, metrics = bandit.solve(ppo, config, seed=0, updates=60, size=512)
    assert float(bandit.error(bandit.policy_params(jax.random.key(0)))) > 0.4
    assert float(bandit.error(state.params)) < 0.05
    assert bool(jnp.all(jnp.isfinite(metrics["kl"])))


def test_vmap_equals_separate_runs():
    config = ppo.PPOConfig(epochs=1, minibatch_size=16)

    def run(params, batch, key):
        return ppo.update(ppo.init(params, config), batch, key, transformer.apply, config)

    members = []
    for seed in range(2):
        params = bandit.policy_params(jax.random.key(seed))
        members.append(
            (params, bandit.batch(params, jax.random.key(10 + seed), 32), jax.random.key(20 + seed))
        )
    together = jax.jit(jax.vmap(run))(*jax.tree.map(lambda *x: jnp.stack(x), *members))
    alone = [jax.jit(run)(*member) for member in members]
    compare = partial(np.testing.assert_allclose, rtol=1e-3, atol=1e-5)
    jax.tree.map(compare, together, jax.tree.map(lambda *x: np.stack(x), *alone))


def test_equal_advantages_are_none_however_their_mean_is_rounded():
    """An accelerator sums in another order than the next; 0.1 has no exact mean in float32."""
    nearly = jnp.full(3, 0.1, jnp.float32).at[0].add(jnp.finfo(jnp.float32).eps * 0.1)
    np.testing.assert_array_equal(standardise(nearly), np.zeros(3))
    small = jnp.array([1e-6, -1e-6], jnp.float32)
    np.testing.assert_allclose(standardise(small), [1.0, -1.0], rtol=0.02)


def test_standardise_by_hand():
    # Mean 3, population standard deviation 2.
    np.testing.assert_allclose(
        standardise(jnp.array([1.0, 5.0, 1.0, 5.0])), [-1.0, 1.0, -1.0, 1.0], rtol=1e-6
    )
    np.testing.assert_array_equal(standardise(jnp.full(3, 4.0)), np.zeros(3))


def test_minibatches_cover_every_row_once_an_epoch():
    indices = np.asarray(minibatch_indices(jax.random.key(0), 12, 4, epochs=3))
    assert indices.shape == (9, 4)
    epochs = indices.reshape(3, 12)
    np.testing.assert_array_equal(np.sort(epochs, axis=1), np.tile(np.arange(12), (3, 1)))
    assert len({tuple(epoch) for epoch in epochs}) == 3


def test_incomplete_minibatch_sits_out():
    indices = np.asarray(minibatch_indices(jax.random.key(0), 10, 4, epochs=2)).reshape(2, 8)
    assert all(len(set(epoch)) == 8 for epoch in indices)


def test_batch_smaller_than_a_minibatch_is_refused():
    params = bandit.policy_params(jax.random.key(0))
    batch = bandit.batch(params, jax.random.key(1), 16)
    config = ppo.PPOConfig()
    with pytest.raises(ValueError, match="minibatch of 256 rows cannot be drawn from a batch of 16"):
        ppo.update(ppo.init(params, config), batch, jax.random.key(0), transformer.apply, config)


def test_batch_is_a_pytree():
    batch = PolicyBatch(*(jnp.zeros((4, n)) for n in (3, 2)), jnp.zeros(4), jnp.zeros(4))
    assert jax.tree.map(lambda x: x[:2], batch).actions.shape == (2, 2)


@pytest.mark.parametrize("name", ["learning_rate", "clip", "epochs", "minibatch_size", "max_gradient_norm"])
def test_configuration_is_checked(name):
    with pytest.raises(ValueError, match=f"PPOConfig: {name} must be positive, got 0"):
        dataclasses.replace(ppo.PPOConfig(), **{name: 0})
