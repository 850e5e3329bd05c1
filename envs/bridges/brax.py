"""Environments as `brax.envs.Env`, so that brax's own wrappers and other brax code run on them."""

from typing import Any

import jax
from brax.envs.base import Env as BraxEnv
from brax.envs.base import State as BraxState

from envs.bridges import episodes
from envs.types import State
from envs.wrappers import Environment


class BraxBridge(BraxEnv):
    """An environment of this project with brax's interface; `done` is termination alone, as brax has it.

    brax's `EpisodeWrapper` applies the time limit and writes `info["truncation"]`. Its `AutoResetWrapper` puts back
    the physics and the observation of the first reset and nothing else; the next step sees physics at time 0 in an
    episode under way, and draws the episode's own info (`info["env"]`: steps, a grounded environment's member) afresh.
    """

    def __init__(self, env: Environment):
        self._env = env

    def reset(self, rng: jax.Array) -> BraxState:
        """The first state of an episode; keeps a key for later ones in `info["env_key"]`. `rng` is consumed."""
        return _to_brax(*episodes.first(self._env, rng), {})

    def step(self, state: BraxState, action: jax.Array) -> BraxState:
        """One step under `action [A]`; keeps what brax's wrappers have added to `info` and `metrics`."""
        after, info = episodes.following(self._env, state.pipeline_state, state.obs, state.info, action)
        return _to_brax(after, info, state.metrics)

    @property
    def observation_size(self) -> int:
        return self._env.observation_size

    @property
    def action_size(self) -> int:
        return self._env.action_size

    @property
    def backend(self) -> str:
        return "mujoco"


def _to_brax(state: State, info: dict[str, Any], metrics: dict[str, jax.Array]) -> BraxState:
    return BraxState(
        pipeline_state=state.data,
        obs=state.obs,
        reward=state.reward,
        done=state.info["terminated"],
        metrics={**metrics, **state.metrics},
        info=info,
    )
