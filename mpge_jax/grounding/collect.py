"""What grounding learns from: transitions of the simulator as K rollout policies drive it through pi_g.

Shapes: as in `mpge_jax.grounding.adversarial`.
"""

from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from envs import Env, State, finite_or, select
from mpge_jax.grounding import transformer
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.discriminator import Transitions
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.learning import grouped, lockstep
from mpge_jax.rollouts.rollout import RolloutPolicies
from mpge_jax.rollouts.target_log import TargetLog


class Rows(flax.struct.PyTreeNode):
    """T * J * B transitions of the grounded simulator, the J branches of a state B rows apart.

    Attributes:
      observation, action, next_observation: (s, a, s'), a the raw action of the rollout policy.
      delta: the draw of pi_g, before any clipping.
      log_prob: of `delta`.
      rollout_policy: which policy asked for `action`.
      expected: where the untouched simulator goes from (s, a), for a discriminator of residuals; else None.
    """

    observation: Float[Array, "*n O"]
    action: Float[Array, "*n A"]
    next_observation: Float[Array, "*n O"]
    delta: Float[Array, "*n A"]
    log_prob: Float[Array, "*n"]
    rollout_policy: Int[Array, "*n"]
    expected: Float[Array, "*n O"] | None

    @property
    def transitions(self) -> Transitions:
        """What the discriminator sees of them."""
        return Transitions(self.observation, self.action, self.next_observation, self.expected)


def collect(
    key: PRNGKeyArray,
    pi_g: Transformer,
    begun: tuple[State, Int[Array, " B"]],
    env: Env,
    policies: RolloutPolicies,
    starts: TargetLog,
    config: GroundingConfig,
) -> tuple[tuple[State, Int[Array, " B"]], Rows]:
    """T steps of B simulators under K rollout policies and pi_g. `key` is consumed.

    Args:
      begun: the B simulators, and the rollout policy that acts in each; as from `start`.
      starts: rows of the target log that episodes may begin in, as from `starts_of`.

    Returns:
      What `begun` has become, and the rows in the order `[T, J, B]`.
    """
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)

    def ask(params: Any, given: tuple[Float[Array, " O"], PRNGKeyArray]) -> Float[Array, " A"]:
        return policies.act(params, *given)

    def body(carry: tuple[State, Int[Array, " B"]], key: PRNGKeyArray) -> tuple[Any, Rows]:
        env_state, which = carry
        key_act, key_delta, key_start = jax.random.split(key, 3)
        obs = env_state.obs
        asking = obs, jax.random.split(key_act, config.num_envs)
        action = grouped.apply(ask, policies.params, asking, which)
        expected = expected_next(env, obs, action) if config.needs_expected else None
        # A branch is a copy of the whole row of simulators; the first is the one that goes on.
        before, at, asked, asker, expected = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (config.branches, *x.shape)),
            (env_state, obs, action, which, expected),
        )
        delta, log_prob = transformer.sample(pi_g, key_delta, at, asked)
        executed = transformer.transform(delta, asked, low, high)
        reached = jax.vmap(jax.vmap(env.step))(before, executed)
        row = Rows(at, asked, finite_or(reached.info["next_obs"], at), delta, log_prob, asker, expected)
        after = jax.tree.map(lambda x: x[0], reached)
        ended = after.done > 0
        if config.restart_steps:
            ended = ended | (after.info["steps"] >= config.restart_steps)

        def restarted() -> tuple[State, Int[Array, " B"]]:
            keys = jax.random.split(key_start, config.num_envs)
            return select(ended, jax.vmap(lambda k: start(k, env, starts, config))(keys), (after, which))

        some = lockstep.largest(jnp.any(ended))
        return jax.lax.cond(some, restarted, lambda: (after, which)), row

    keys = jax.random.split(key, config.steps_per_iteration)
    begun, rows = jax.lax.scan(body, begun, keys)
    return begun, jax.tree.map(lambda x: x.reshape(-1, *x.shape[3:]), rows)


def expected_next(env: Env, obs: Float[Array, "B O"], action: Float[Array, "B A"]) -> Float[Array, "B O"]:
    """The simulator's own next observations, without a transformer; where one diverges, `obs`."""
    return finite_or(jax.vmap(env.predict)(obs, action), obs)


def starts_of(env: Env, log: TargetLog, config: GroundingConfig) -> TargetLog:
    """The rows of a log that episodes may begin in: where they begin in logged ones, those that tell their state."""
    if not config.restart_steps:
        return log
    return log.only(jax.vmap(jax.vmap(env.tells_state))(log.observation))


def start(
    key: PRNGKeyArray, env: Env, starts: TargetLog, config: GroundingConfig
) -> tuple[State, Int[Array, ""]]:
    """The first state of an episode, and the rollout policy drawn for it. `key` is consumed.

    Args:
      starts: as from `starts_of`. Of a policy without such a row it is the policy's first row.
    """
    key_policy, key_state = jax.random.split(key)
    which = jax.random.randint(key_policy, (), 0, starts.count.shape[0])
    if config.restart_steps:
        row = jax.random.randint(key_state, (), 0, starts.count[which])
        return env.state_from_obs(starts.observation[which, row]), which
    return env.reset(key_state), which
