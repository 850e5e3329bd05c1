"""A contextual bandit with a known answer, for TRPO and PPO alike."""

from functools import partial
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp

from mpge_jax.grounding import transformer
from mpge_jax.learning.distributions import gaussian_log_prob, gaussian_sample
from mpge_jax.learning.policy_gradient import PolicyBatch

CONTEXTS = 2


def best_action(contexts: jax.Array) -> jax.Array:
    """The action `[B, 1]` that earns the highest reward in each of the `contexts` `[B, 2]`."""
    return 0.8 * contexts[:, :1] - 0.5 * contexts[:, 1:]


@jax.jit
def policy_params(key: jax.Array) -> Any:
    config = transformer.TransformerConfig(hidden=(16,), init_log_std=-0.5)
    return transformer.init(key, CONTEXTS - 1, 1, config).params


@partial(jax.jit, static_argnames="size")
def batch(params: Any, key: jax.Array, size: int) -> PolicyBatch:
    """`size` decisions of the policy, rewarded by `-(a - best)^2`."""
    context_key, action_key = jax.random.split(key)
    contexts = jax.random.uniform(context_key, (size, CONTEXTS), minval=-1.0)
    mean, log_std = transformer.apply(params, contexts)
    actions = gaussian_sample(action_key, mean, log_std)
    return PolicyBatch(
        inputs=contexts,
        actions=actions,
        log_probs=gaussian_log_prob(actions, mean, log_std),
        advantages=-((actions - best_action(contexts)) ** 2)[:, 0],
    )


def error(params: Any) -> jax.Array:
    """Mean distance of the policy's mean action from the best one; about 0.5 for doing nothing."""
    contexts = jax.random.uniform(jax.random.key(99), (512, CONTEXTS), minval=-1.0)
    return jnp.mean(jnp.abs(transformer.apply(params, contexts)[0] - best_action(contexts)))


def solve(algorithm: ModuleType, config: Any, seed: int, updates: int, size: int) -> tuple[Any, dict]:
    """Final state and metrics `[updates]` of `updates` updates of `algorithm` (`trpo` or `ppo`)."""

    def step(state: Any, key: jax.Array) -> tuple[Any, dict]:
        batch_key, update_key = jax.random.split(key)
        rows = batch(state.params, batch_key, size)
        return algorithm.update(state, rows, update_key, transformer.apply, config)

    init_key, run_key = jax.random.split(jax.random.key(seed))
    state = algorithm.init(policy_params(init_key), config)
    return jax.jit(lambda s, k: jax.lax.scan(step, s, jax.random.split(k, updates)))(state, run_key)
