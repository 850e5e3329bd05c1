"""A simulator behind action transformers: what an agent trains in before it meets the target."""

import jax
import jax.numpy as jnp

from envs import Env, State, Wrapper
from mpge_jax.grounding import transformer
from mpge_jax.grounding.transformer import Transformer


class GroundedEnv(Wrapper):
    """An environment like any other, whose actions pass through one of N transformers, drawn at every reset.

    pi_g is deterministic here. The reward is that of the action asked for: the agent pays for its own control effort,
    not for what the transformer makes of it. `step(state, action)` takes an action `[A]` in the actuators' units, and
    `state.obs` is `[O]`; `jax.vmap` makes many.

    Args:
      env: the simulator.
      transformers: one transformer, or N of them stacked (every leaf `[N, ...]`).

    Raises:
      ValueError: these are no transformers, or those of another task.
    """

    _env: Env

    def __init__(self, env: Env, transformers: Transformer):
        super().__init__(env)
        if not isinstance(transformers, Transformer):
            raise ValueError(
                f"GroundedEnv needs transformers, as `ground` returns them, not {transformers!r:.60}"
            )
        size, inputs = env.observation_size + env.action_size, int(transformers.input_mean.shape[-1])
        if inputs != size:
            raise ValueError(
                f"these transformers are of another task: they take {inputs} numbers, but {env.name} has "
                f"{env.observation_size} observations and {env.action_size} actions"
            )
        stacked = transformers.input_mean.ndim == 2
        self._members = transformers if stacked else jax.tree.map(lambda x: x[None], transformers)

    def reset(self, key: jax.Array) -> State:
        """The first state of an episode; `info["member"]` is the transformer drawn for it. `key` is consumed."""
        key_member, key_reset = jax.random.split(key)
        state = self._env.reset(key_reset)
        member = jax.random.randint(key_member, (), 0, self._members.input_mean.shape[0])
        return state.replace(info={**state.info, "member": member})

    def state_from_obs(self, obs: jax.Array, member: int | jax.Array = 0) -> State:
        """A state that has the observation `obs [O]`, grounded by the transformer `member`; else as the simulator's."""
        state = self._env.state_from_obs(obs)
        return state.replace(info={**state.info, "member": jnp.asarray(member)})

    def predict(self, obs: jax.Array, action: jax.Array, member: int | jax.Array = 0) -> jax.Array:
        """The next observation `[O]` after `action [A]` in a state that has the observation `obs [O]`."""
        return self.step(self.state_from_obs(obs, member), action).info["next_obs"]

    def step(self, state: State, action: jax.Array) -> State:
        """One step of the simulator under the transformed `action [A]`."""
        pi_g = jax.tree.map(lambda x: x[state.info["member"]], self._members)
        low, high = jnp.asarray(self._env.action_low), jnp.asarray(self._env.action_high)
        executed = transformer.deterministic(pi_g, state.obs, jnp.clip(action, low, high), low, high)
        return self._env.step(state, executed, charged=action)
