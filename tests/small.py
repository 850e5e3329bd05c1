"""Small policies, logs and transformers on the real tasks, shared between tests.

What is made once is kept, so it must not be asked for the first time inside of a traced function.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

import envs
from mpge_jax.grounding import transformer
from mpge_jax.grounding.transformer import Transformer, TransformerConfig
from mpge_jax.learning import sac
from mpge_jax.learning.sac import SACConfig
from mpge_jax.rollouts import policies, target_log
from mpge_jax.rollouts.policies import PolicySet
from mpge_jax.rollouts.target_log import TargetLog

SAC = SACConfig(hidden=(8,), batch_size=8)


@cache
def env(name: str) -> envs.Env:
    return envs.make(name, "c")


@cache
def policy_set(
    name: str = "InvertedPendulum", size: int = 3, seed: int = 0, log_std: float = -1.0
) -> PolicySet:
    """`size` untrained policies that differ widely, each with a spread of its own around `log_std`."""
    task = env(name)
    make = jax.jit(
        jax.vmap(lambda key: sac.init(key, task.observation_size, task.action_size, task.action_high, SAC))
    )
    chosen = policies.from_learners(make(jax.random.split(jax.random.key(seed), size)))
    last = chosen.actor.params["params"]["Dense_1"]
    means = jnp.linspace(-0.6, 0.6, size)[:, None] + jnp.zeros((size, task.action_size))
    spreads = log_std + 0.1 * jnp.arange(size)[:, None] + jnp.zeros((size, task.action_size))
    layers = {
        **chosen.actor.params["params"],
        "Dense_1": {
            # The spread does not depend on the observation.
            "kernel": last["kernel"].at[:, :, task.action_size :].set(0.0),
            "bias": jnp.concatenate([means, spreads], axis=1),
        },
    }
    return chosen.replace(actor=chosen.actor.replace(params={"params": layers}))


@cache
def log(name: str = "SkewedPendulum", size: int = 3, steps: int = 40, log_std: float = -1.0) -> TargetLog:
    """What `policy_set` does in the target `name`."""
    chosen = policy_set(envs.source_of(name), size, log_std=log_std)
    return target_log.collect(jax.random.key(5), env(name), chosen.rollout, steps)


def constant(task: envs.Env, delta: float | list[float]) -> Transformer:
    """A transformer that adds `delta` to every action."""
    made = transformer.init(
        jax.random.key(0), task.observation_size, task.action_size, TransformerConfig(hidden=())
    )
    (layer,) = made.params["mean"]["params"].values()
    bias = jnp.broadcast_to(jnp.asarray(delta, jnp.float32), layer["bias"].shape)
    mean = {"params": {"Dense_0": {"kernel": jnp.zeros_like(layer["kernel"]), "bias": bias}}}
    return made.replace(params={**made.params, "mean": mean})


def stacked(*trees):
    return jax.tree.map(lambda *x: jnp.stack(x), *trees)


@cache
def _stepper(name: str):
    task = env(name)
    return jax.jit(jax.vmap(lambda obs, act: task.step(task.state_from_obs(obs), act).info["next_obs"]))


def step_from(name: str, observation: np.ndarray, action: np.ndarray) -> np.ndarray:
    """Where one step of `name` leads from each observation `[B, O]` under each action `[B, A]`."""
    return np.asarray(_stepper(name)(jnp.asarray(observation), jnp.asarray(action)))
