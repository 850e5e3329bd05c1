"""Grounding on the point probe: rollout policies that are plain functions, their log, and small settings.

The target moves as the source does under `a + 0.5`, clipped: that change is the truth.
"""

from functools import cache

import jax
import jax.numpy as jnp

from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.discriminator import DiscriminatorConfig
from mpge_jax.grounding.transformer import TransformerConfig
from mpge_jax.learning.trpo import TRPOConfig
from mpge_jax.rollouts import target_log
from mpge_jax.rollouts.rollout import RolloutPolicies
from mpge_jax.rollouts.target_log import TargetLog
from tests import probes

SHIFT = 0.5
SOURCE = probes.point()
TARGET = probes.point(shift=SHIFT)

CONFIG = GroundingConfig(
    num_envs=8,
    steps_per_iteration=6,
    iterations=3,
    transformer=TransformerConfig(hidden=(8,), init_log_std=-0.5),
    policy=TRPOConfig(cg_iterations=3),
    discriminator=DiscriminatorConfig(hidden=(8,)),
    discriminator_updates=2,
    discriminator_batch=16,
    value_epochs=1,
    value_minibatch=8,
)


def act(params: jax.Array, obs: jax.Array, key: jax.Array) -> jax.Array:
    """A linear policy with noise: `params` are its slope and its offset."""
    return params[0] * obs + params[1] + 0.1 * jax.random.normal(key, obs.shape)


def policies(offset: float = 0.0) -> RolloutPolicies:
    """Three of them."""
    return RolloutPolicies(params=jnp.array([[-0.5, -0.3], [-0.7, 0.0], [-0.6, 0.3]]) + offset, act=act)


@cache
def log(seed: int = 0, steps: int = 60) -> TargetLog:
    """What they do in the target."""
    return target_log.collect(jax.random.key(seed), TARGET, policies(), steps)


def truth(action: jax.Array) -> jax.Array:
    return jnp.clip(action + SHIFT, -1.0, 1.0)
