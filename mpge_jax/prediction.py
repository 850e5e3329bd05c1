"""How well a grounded simulator predicts the target's next observation: a measure that needs no true transform.

Shapes: `K` rollout policies, `M` rows of a policy, `O` observation size.
"""

import jax
import jax.numpy as jnp

from envs import Env
from mpge_jax import transformer
from mpge_jax.target_log import TargetLog
from mpge_jax.transformer import Transformer


def hold_out(log: TargetLog, share: float) -> tuple[TargetLog, jax.Array]:
    """Keeps the last `share` of every policy's rows back (at least one, where it has two).

    Returns:
      The log that remains, and a mask `[K, M]` of the rows held out.
    """
    kept = jnp.clip(jnp.floor(log.count * (1.0 - share)).astype(log.count.dtype), 1, log.count)
    row = jnp.arange(log.observation.shape[1])[None, :]
    return log.replace(count=kept), (row >= kept[:, None]) & (row < log.count[:, None])


def one_step_error(env: Env, pi_g: Transformer, log: TargetLog, rows: jax.Array) -> jax.Array:
    """Root mean square error, `[]`, of the predicted s', in standard deviations of s' - s; infinite where one diverges.

    Every row starts anew from its logged state, under the deterministic pi_g.

    Args:
      env: the simulator.
      pi_g: what is judged.
      log: transitions of the target.
      rows: which of them count, `[K, M]`, at least one.

    Raises:
      ValueError: an observation of `env` does not determine its state.
    """
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)

    def predict(observation: jax.Array, action: jax.Array) -> jax.Array:
        executed = transformer.deterministic(pi_g, observation, action, low, high)
        return env.predict(observation, executed)

    predicted = jax.vmap(jax.vmap(predict))(log.observation, log.action)
    total = jnp.sum(rows)

    def average(values: jax.Array) -> jax.Array:
        # Chosen, not multiplied by 0: padding may diverge.
        return jnp.sum(jnp.where(rows[..., None], values, 0.0), axis=(0, 1)) / total

    change = log.next_observation - log.observation
    variance = average((change - average(change)[None, None]) ** 2)
    squared = average((predicted - log.next_observation) ** 2)
    error = jnp.sqrt(jnp.mean(squared / jnp.maximum(variance, 1e-12)))
    return jnp.where(jnp.isnan(error), jnp.inf, error)
