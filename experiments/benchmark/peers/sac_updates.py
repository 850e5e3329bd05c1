"""SAC updates beside SBX (JAX) and Stable-Baselines3 (PyTorch): 256-256, batch 256, HalfCheetah's sizes."""

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import jax
import numpy as np

from experiments.benchmark.clock import stepper
from experiments.benchmark.peers.in_turn import OURS, Call, is_there, over
from experiments.benchmark.sac import ACTION, OBSERVATION, ROWS, agent, full_buffer
from mpge_jax.learning import sac
from mpge_jax.learning.sac import SACConfig

PEERS = {"SBX": "sbx", "Stable-Baselines3": "stable_baselines3"}


class _Sizes(gymnasium.Env):
    """Nothing but HalfCheetah's sizes: what is learned from is drawn."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (OBSERVATION,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTION,), np.float32)

    def reset(self, **_: Any) -> tuple[np.ndarray, dict[str, Any]]:
        return np.zeros(OBSERVATION, np.float32), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        del action
        return np.zeros(OBSERVATION, np.float32), 0.0, False, False, {}


def calls(updates: int, config: SACConfig) -> dict[str, Call]:
    """By name, `updates` SAC updates on batches drawn from a full buffer: ours, and each peer that is installed."""
    found: dict[str, Call] = {OURS: _ours(updates, config)}
    if is_there("sbx"):
        import sbx

        found["SBX"] = _theirs(sbx.SAC, updates, config, lambda agent: agent.policy.actor_state.params)
    if is_there("stable_baselines3"):
        import stable_baselines3

        found["Stable-Baselines3"] = _theirs(stable_baselines3.SAC, updates, config, device="cpu")
    return found


def _ours(updates: int, config: SACConfig) -> Call:
    memory = full_buffer(jax.random.key(0))

    @partial(jax.jit, donate_argnums=0)
    def step(carry: tuple[sac.SACState, jax.Array]) -> tuple[sac.SACState, jax.Array]:
        learner, key = carry
        key, key_updates = jax.random.split(key)
        return sac.update_many(learner, memory, key_updates, updates, config)[0], key

    start = jax.jit(partial(agent, config=config))(jax.random.key(0))
    return over(stepper(step, (start, jax.random.key(1))))


def _theirs(
    agent_class: Any,
    updates: int,
    config: SACConfig,
    done: Callable[[Any], Any] = lambda _: None,
    **options: Any,
) -> Call:
    learner = agent_class(
        "MlpPolicy",
        _Sizes(),
        learning_rate=config.critic_lr,
        buffer_size=ROWS,
        batch_size=config.batch_size,
        tau=config.tau,
        gamma=config.gamma,
        policy_kwargs={"net_arch": list(config.hidden)},
        **options,
    )
    # Makes its logger, as `learn` would.
    learner._setup_learn(total_timesteps=1)
    memory, draw = learner.replay_buffer, np.random.default_rng(0).normal
    for rows in (memory.observations, memory.next_observations, memory.rewards):
        rows[:] = draw(size=rows.shape)
    memory.actions[:] = np.tanh(draw(size=memory.actions.shape))
    memory.full = True

    def call() -> None:
        learner.train(gradient_steps=updates, batch_size=config.batch_size)
        # What JAX has only begun.
        jax.block_until_ready(done(learner))

    return call
