"""Episodes under the auto-reset wrappers of brax and Playground, which put back physics and observation only."""

from typing import Any

import jax

from envs.select import select
from envs.types import State
from envs.wrappers import Environment


def first(env: Environment, key: jax.Array) -> tuple[State, dict[str, Any]]:
    """The first state of an episode, and the info of a bridge: a key for later episodes, and the state's own info.

    The latter lies under a key of its own: wrappers keep a `steps` of another meaning at the top level.
    `key` is consumed.
    """
    key, key_reset = jax.random.split(key)
    state = env.reset(key_reset)
    return state, {"env_key": key, "env": state.info}


def following(
    env: Environment, data: Any, obs: jax.Array, info: dict[str, Any], action: jax.Array
) -> tuple[State, dict[str, Any]]:
    """The state after `action [A]`, and the bridge's info, in which what wrappers have added is kept.

    Physics at time 0 in an episode under way was put back by a wrapper: a new episode has begun, and draws its own info
    (steps, a grounded environment's member) afresh.
    """
    info = dict(info)
    own = info.pop("env")
    info["env_key"], key_episode = jax.random.split(info["env_key"])
    begun = {**env.reset(key_episode).info, "next_obs": obs}
    own = select((data.time == 0) & (own["steps"] > 0), begun, own)
    zero = jax.numpy.zeros_like(own["terminated"])
    state = env.step(State(data, obs, zero, zero, {}, own), action)
    return state, {**info, "env": state.info}
