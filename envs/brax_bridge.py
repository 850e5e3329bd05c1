"""Environments as `brax.envs.Env`, so that brax's own wrappers and other brax code run on them."""

from typing import Any

import jax
from brax.envs.base import Env as BraxEnv
from brax.envs.base import State as BraxState

from envs.types import State
from envs.wrappers import Environment


class BraxBridge(BraxEnv):
    """An environment of this project with brax's interface; `done` is termination alone, as brax has it.

    brax's `EpisodeWrapper` applies the time limit and writes `info["truncation"]`.
    """

    def __init__(self, env: Environment):
        self._env = env

    def reset(self, rng: jax.Array) -> BraxState:
        return _to_brax(self._env.reset(rng), {})

    def step(self, state: BraxState, action: jax.Array) -> BraxState:
        info = dict(state.info)
        # Under a key of its own: brax's wrappers keep a `steps` of another meaning at the top level.
        own = info.pop("env")
        inner = State(state.pipeline_state, state.obs, state.reward, state.done, state.metrics, own)
        return _to_brax(self._env.step(inner, action), info)

    @property
    def observation_size(self) -> int:
        return self._env.observation_size

    @property
    def action_size(self) -> int:
        return self._env.action_size

    @property
    def backend(self) -> str:
        return "mujoco"


def _to_brax(state: State, info: dict[str, Any]) -> BraxState:
    return BraxState(
        pipeline_state=state.data,
        obs=state.obs,
        reward=state.reward,
        done=state.info["terminated"],
        metrics=state.metrics,
        info={**info, "env": state.info},
    )
