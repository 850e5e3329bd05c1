"""How well a grounded simulator predicts the target's next observation: a measure that needs no true transform.

Shapes: `K` rollout policies, `M` rows of a policy, `H` rows held out, `O` observation, `A` action size.
"""

from functools import partial

import flax.struct
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from envs import Env
from mpge_jax.grounding import transformer
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.rollouts.target_log import TargetLog


class HeldOut(flax.struct.PyTreeNode):
    """Target transitions that nothing was learned from.

    Attributes:
      observation: s.
      action: what the policy asked for.
      next_observation: s'.
      weight: 1, or 0 for padding. Rows that do not tell their state do not count either.
    """

    observation: Float[Array, "*n H O"]
    action: Float[Array, "*n H A"]
    next_observation: Float[Array, "*n H O"]
    weight: Float[Array, "*n H"]


@partial(jax.jit, static_argnames=("share", "most"))
def hold_out(log: TargetLog, share: float, most: int = 256) -> tuple[TargetLog, HeldOut]:
    """Keeps the last `share` of every policy's rows back (at least one, where it has two).

    Returns:
      The log that remains, and at most `most` of the rows held out, spread evenly over all of them.
    """
    kept = jnp.clip(jnp.floor(log.count * (1.0 - share)).astype(log.count.dtype), 1, log.count)
    row = jnp.arange(log.observation.shape[1])[None, :]
    mask = ((row >= kept[:, None]) & (row < log.count[:, None])).reshape(-1)
    size = min(most, mask.shape[0])
    total = jnp.sum(mask)
    # Rows held out first, in their order; where there are fewer than `size`, each is taken once.
    order = jnp.argsort(~mask, stable=True)
    place = jnp.arange(size)
    spread = jnp.where(total > size, (place * total) // size, place)
    chosen = order[spread]
    flat = jax.tree.map(
        lambda x: x.reshape(-1, x.shape[-1])[chosen], (log.observation, log.action, log.next_observation)
    )
    return log.replace(count=kept), HeldOut(flat[0], flat[1], flat[2], (place < total).astype(jnp.float32))


def one_step_error(env: Env, pi_g: Transformer, rows: HeldOut) -> Float[Array, ""]:
    """Root mean square error of the predicted s', in standard deviations of s' - s, over rows that tell their state;
    infinite where there is none, or one diverges.

    Every row starts anew from its logged state, under the deterministic pi_g.

    Args:
      env: the simulator.
      pi_g: what is judged.
      rows: transitions of the target, at least one.

    Raises:
      ValueError: an observation of `env` does not determine its state.
    """
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)
    return error_under(env, rows, transformer.deterministic(pi_g, rows.observation, rows.action, low, high))


def error_under(env: Env, rows: HeldOut, executed: Float[Array, "H A"]) -> Float[Array, ""]:
    """The error of `one_step_error` where the simulator executes the actions `executed`, whatever was asked for.

    Raises:
      ValueError: an observation of `env` does not determine its state.
    """
    predicted = jax.vmap(env.predict)(rows.observation, executed)
    counts = ((rows.weight > 0) & jax.vmap(env.tells_state)(rows.observation))[:, None]

    def average(values: Float[Array, "H O"]) -> Float[Array, " O"]:
        # Chosen, not multiplied by 0: padding may diverge.
        return jnp.sum(jnp.where(counts, values, 0.0), axis=0) / jnp.sum(counts)

    change = rows.next_observation - rows.observation
    variance = average((change - average(change)[None]) ** 2)
    squared = average((predicted - rows.next_observation) ** 2)
    error = jnp.sqrt(jnp.mean(squared / jnp.maximum(variance, 1e-12)))
    return jnp.where(jnp.isnan(error), jnp.inf, error)
