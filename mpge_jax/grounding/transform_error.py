"""How far a transformer is from the true change of actions, where there is one (the paper's heat maps).

A target that changes actions (`Variant.action`) is reproduced exactly by that change: the error is the mean L2
distance to it, in action units, of the deterministic pi_g. Doing nothing scores 1.5 on SkewedPendulum at most and 0.5
on the Broken tasks.

Shapes: `B` rows, `O` observation, `A` action size.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from envs import AutoReset, Env, State
from mpge_jax.grounding import transformer
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.learning.policy_gradient import Metrics
from mpge_jax.rollouts.target_log import TargetLog

Act = Callable[[Float[Array, "B O"], PRNGKeyArray], Float[Array, "B A"]]
Bound = Float[Array, " A"]
Executed = Callable[[Any, Float[Array, "B O"], Float[Array, "B A"], Bound, Bound], Float[Array, "B A"]]
"""What a model makes of actions at observations, within the box [low, high]."""
Truth = Callable[[Float[Array, " A"]], Float[Array, " A"]]


def truth_of(target: Env) -> Truth | None:
    """The change `action [A] -> action [A]` that makes the source move as `target`, or None where no action does: a
    target that changes more than actions has none."""
    variant = target.variant
    if variant is None or variant.action is None:
        return None
    if variant.spec is not None or variant.total_mass is not None or variant.delay:
        return None
    change = variant.action
    return lambda action: change(action, jnp.asarray(target.action_low), jnp.asarray(target.action_high))


def mean_error(
    pi_g: Any,
    env: Env,
    truth: Truth,
    observation: Float[Array, "B O"],
    action: Float[Array, "B A"],
    executed: Executed = transformer.deterministic,
) -> Float[Array, ""]:
    """Mean L2 distance between pi_g and the truth at `observation`, `action`.

    Args:
      pi_g: a transformer, or what else `executed` takes.
    """
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)
    given = executed(pi_g, observation, action, low, high)
    return jnp.mean(jnp.linalg.norm(given - jax.vmap(truth)(action), axis=-1))


def on_log(key: PRNGKeyArray, pi_g: Transformer, env: Env, truth: Truth, log: TargetLog) -> Metrics:
    """`error_uniform` and `error_own`: at logged states, for uniform random actions and for the logged ones.

    1,024 rows drawn from the log with replacement; costs no simulation. `key` is consumed.
    """
    key_policy, key_row, key_action = jax.random.split(key, 3)
    which = jax.random.randint(key_policy, (1024,), 0, log.count.shape[0])
    row = jax.random.randint(key_row, (1024,), 0, log.count[which])
    observation, own = log.observation[which, row], log.action[which, row]
    uniform = _uniform(key_action, env, 1024)
    return {
        "error_uniform": mean_error(pi_g, env, truth, observation, uniform),
        "error_own": mean_error(pi_g, env, truth, observation, own),
    }


def in_rollouts(
    key: PRNGKeyArray,
    pi_g: Any,
    env: Env,
    truth: Truth,
    steps: int = 2048,
    act: Act | None = None,
    executed: Executed = transformer.deterministic,
) -> Float[Array, ""]:
    """The paper's figures: along `steps` steps in the simulator grounded by `pi_g`, of uniform random actions, or of
    the policy `act` (observation [B, O], key) -> action [B, A] (its heat map).

    Eight episodes side by side, from the task's own starts. `key` is consumed. `pi_g` and `executed` are as in
    `mean_error`.
    """
    copies = 8
    key_reset, key_act = jax.random.split(key)
    wrapped = AutoReset(env)
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)
    first = jax.vmap(wrapped.reset)(jax.random.split(key_reset, copies))

    def body(state: State, key: PRNGKeyArray) -> tuple[State, Float[Array, ""]]:
        action = _uniform(key, env, copies) if act is None else act(state.obs, key)
        given = executed(pi_g, state.obs, action, low, high)
        return jax.vmap(wrapped.step)(state, given), mean_error(pi_g, env, truth, state.obs, action, executed)

    _, errors = jax.lax.scan(body, first, jax.random.split(key_act, steps // copies))
    return jnp.mean(errors)


def _uniform(key: PRNGKeyArray, env: Env, count: int) -> Float[Array, "B A"]:
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)
    return jax.random.uniform(key, (count, env.action_size), minval=low, maxval=high)
