"""A policy trained in one simulator and judged in the target."""

from pathlib import Path

import jax
import numpy as np

from envs import Env
from mpge_jax import loop
from mpge_jax.learning import agent
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.sac import Actor, SACConfig

CONFIG = AgentConfig(
    sac=SACConfig(hidden=(64, 64), actor_lr=1e-3, critic_lr=1e-3, alpha_lr=1e-3, gamma=0.97, batch_size=128),
    num_envs=16,
    steps_per_iteration=16,
    updates_per_iteration=128,
    buffer_capacity=100_000,
    random_steps=1600,
)
ITERATIONS, EPISODES = 120, 50


def train(
    env: Env, title: str, seed: int, folder: Path | None = None, quiet: bool = False
) -> tuple[Actor, np.ndarray]:
    """A policy, and the mean return of the last finished episodes of each iteration, NaN before the first ended."""
    init = jax.jit(lambda key: agent.init(key, env, CONFIG))
    step = jax.jit(lambda state: agent.iterate(state, env, CONFIG), donate_argnums=0)
    state, curve = loop.run(
        step,
        init(jax.random.key(seed)),
        ITERATIONS,
        title=title,
        folder=folder,
        identity={"seed": seed, "title": title},
        note=lambda m: f"return there {m['return']:.0f}",
        quiet=quiet,
    )
    return state.learner.actor, curve["return"]


def returns(env: Env, actor: Actor, seed: int) -> np.ndarray:
    """Returns of whole episodes of the policy's mode."""
    return np.asarray(
        jax.jit(lambda key, a: agent.evaluate(key, env, a, EPISODES))(jax.random.key(seed), actor)
    )
