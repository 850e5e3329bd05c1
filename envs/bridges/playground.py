"""Environments as MuJoCo Playground's `MjxEnv`, so that its wrappers and trainers, and brax's, run on them."""

from typing import Any, cast

import jax
import mujoco
from ml_collections import config_dict
from mujoco import mjx
from mujoco_playground import MjxEnv
from mujoco_playground import State as PlaygroundState

from envs.bridges import episodes
from envs.env import Env
from envs.types import State
from envs.wrappers import Environment


class PlaygroundBridge(MjxEnv):
    """An environment of this project with MuJoCo Playground's interface; `done` is termination alone, as there.

    The time limit is for `wrap_for_brax_training(env, episode_length=env.max_steps)`, whose auto-reset puts back
    physics and observation only: the next step sees that, and draws the episode's own info (`info["env"]`) afresh.
    `State.data` is the physics of the environment's backend, `mjx.Data` on MJX. Playground's wrapper for randomised
    models has no hold on it: what differs is a `Variant` here.
    """

    def __init__(self, env: Environment):
        # Any wrapper gives the attributes of the simulator within.
        self._env = cast(Env, env)
        self.max_steps = env.max_steps
        sim_dt = float(self._env.model.opt.timestep)
        super().__init__(config_dict.create(ctrl_dt=self._env.dt, sim_dt=sim_dt))

    def reset(self, rng: jax.Array) -> PlaygroundState:
        """The first state of an episode; keeps a key for later ones in `info["env_key"]`. `rng` is consumed."""
        return _to_playground(*episodes.first(self._env, rng), {})

    def step(self, state: PlaygroundState, action: jax.Array) -> PlaygroundState:
        """One step under `action [A]`, in the actuators' units; keeps what wrappers have added to `info`, `metrics`."""
        after, info = episodes.following(self._env, state.data, state.obs, state.info, action)
        return _to_playground(after, info, state.metrics)

    @property
    def observation_size(self) -> int:
        return self._env.observation_size

    @property
    def action_size(self) -> int:
        return self._env.action_size

    @property
    def xml_path(self) -> str:
        """The folder of the model file where it has one: models of this project are made in Python."""
        return str(self._env.task.spec().modelfiledir)

    @property
    def mj_model(self) -> mujoco.MjModel:
        return self._env.model

    @property
    def mjx_model(self) -> mjx.Model:
        return mjx.put_model(self._env.model)


def _to_playground(state: State, info: dict[str, Any], metrics: dict[str, jax.Array]) -> PlaygroundState:
    done = state.info["terminated"]
    return PlaygroundState(state.data, state.obs, state.reward, done, {**metrics, **state.metrics}, info)
