"""The transitions of a target log in one line, for what learns from its rows.

Shapes: `R` rows of a log, `O` observation, `A` action size.
"""

import flax.struct
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from mpge_jax.rollouts.target_log import TargetLog


class Trajectories(flax.struct.PyTreeNode):
    """Logged rows in their order, policy by policy, those that are padding at the end.

    Attributes:
      observation, action, following: s, a, s'.
      last: whether the next row is of another episode, or there is none.
      scale: standard deviation of the change `s' - s`, `[O]`.
      count: valid rows, the first ones.
    """

    observation: Float[Array, "*n R O"]
    action: Float[Array, "*n R A"]
    following: Float[Array, "*n R O"]
    last: Bool[Array, "*n R"]
    scale: Float[Array, "*n O"]
    count: Int[Array, "*n"]


def trajectories(log: TargetLog) -> Trajectories:
    """The rows of a log."""
    policies, most = log.observation.shape[:2]
    row = jnp.arange(most)
    ends = jnp.concatenate([log.episode[:, 1:] != log.episode[:, :-1], jnp.ones((policies, 1), bool)], axis=1)
    last = ends | (row[None, :] + 1 >= log.count[:, None])
    order = jnp.argsort(~log.valid.reshape(-1), stable=True)
    flat = lambda x: x.reshape(-1, *x.shape[2:])[order]  # noqa: E731
    kept = flat(log.valid)[:, None]
    change = flat(log.next_observation - log.observation)
    total = jnp.sum(log.count)
    mean = jnp.sum(jnp.where(kept, change, 0.0), axis=0) / total
    spread = jnp.sqrt(jnp.sum(jnp.where(kept, (change - mean[None]) ** 2, 0.0), axis=0) / total)
    return Trajectories(
        flat(log.observation), flat(log.action), flat(log.next_observation), flat(last), spread + 1e-6, total
    )
