"""What acted while a log was recorded, from the log alone: what it did in the nearest of its states.

Who or what steered a real machine is seldom known as a policy, and grounding needs one that drives the simulator as the
target was driven: where actions differ, a discriminator tells the two by the actions alone.

Shapes: `K` parts of a log, `M` states kept of each, `O` observation, `A` action size.
"""

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from mpge_jax.rollouts.rollout import RolloutPolicies
from mpge_jax.rollouts.target_log import TargetLog

NEAREST = 3
"""Logged states between whose actions is drawn."""
MOST = 1024
"""States kept of a part, spread evenly over it: every one is looked at in every step."""


class Memory(flax.struct.PyTreeNode):
    """What one part of a log did.

    Attributes:
      observation: states, each number in its own standard deviations.
      action: what was done there.
      scale: standard deviation of each number of an observation.
      count: valid rows, the first ones.
    """

    observation: Float[Array, "*n M O"]
    action: Float[Array, "*n M A"]
    scale: Float[Array, "*n O"]
    count: Int[Array, "*n"]


def act(memory: Memory, obs: Float[Array, " O"], key: PRNGKeyArray) -> Float[Array, " A"]:
    """The logged action at one of the `NEAREST` logged states, drawn evenly. `key` is consumed."""
    distance = jnp.sum(jnp.square(memory.observation - (obs / memory.scale)[None]), axis=-1)
    valid = jnp.arange(distance.shape[0]) < memory.count
    _, rows = jax.lax.top_k(-jnp.where(valid, distance, jnp.inf), min(NEAREST, distance.shape[0]))
    drawn = jax.random.randint(key, (), 0, jnp.minimum(memory.count, rows.shape[0]))
    return memory.action[rows[drawn]]


def behaviour(log: TargetLog) -> RolloutPolicies:
    """K policies that act as the K parts of a log did."""
    count = np.asarray(log.count)
    most = min(MOST, int(count.max()))
    kept = np.minimum(count, most)
    rows = np.stack([(np.arange(most) * c // k).clip(0, c - 1) for c, k in zip(count, kept, strict=True)])
    observation, action = (
        np.take_along_axis(np.asarray(x), rows[..., None], axis=1) for x in (log.observation, log.action)
    )
    valid = np.concatenate([np.asarray(log.observation)[k, :c] for k, c in enumerate(count)])
    scale = np.maximum(valid.std(axis=0), 1e-6).astype(observation.dtype)
    memory = Memory(
        jnp.asarray(observation / scale),
        jnp.asarray(action),
        jnp.tile(jnp.asarray(scale), (len(count), 1)),
        jnp.asarray(kept, jnp.int32),
    )
    return RolloutPolicies(params=memory, act=act)
