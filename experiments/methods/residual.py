"""A delta action model from the log, and agents trained in the simulator with it."""

import dataclasses
import time
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.methods.cell import Trained, Work
from experiments.methods.grounded import transform_errors
from experiments.methods.logged import prediction_error
from experiments.methods.training import train
from mpge_jax import loop
from mpge_jax.grounding import delta_action, prediction, transform_error
from mpge_jax.grounding.delta_action import DeltaConfig, DeltaEnv, TrackingEnv
from mpge_jax.grounding.prediction import HeldOut
from mpge_jax.grounding.transform_error import Truth
from mpge_jax.learning import agent
from mpge_jax.learning.agent import AgentConfig
from mpge_jax.learning.sac import Actor
from mpge_jax.rollouts.trajectories import Trajectories, trajectories

CONFIG = DeltaConfig()
TEMPERATURE = 0.1
"""Where SAC's temperature starts: a step of following is worth 1 at most, less than the tasks' own rewards."""
DISCOUNT = 0.3
"""What an action does shows at once, and drowns in what all later steps are worth."""


def learner_of(config: AgentConfig, discount: float = DISCOUNT) -> AgentConfig:
    """How a preset's agent learns to follow."""
    return replace(config, sac=replace(config.sac, init_alpha=TEMPERATURE, gamma=discount))


def delta(work: Work) -> Trained:
    """Learns to follow the log, with the budget that the preset gives to an agent; then trains agents."""
    cell, settings = work.cell, work.cell.preset.tasks[work.source.name]
    config = learner_of(settings.agent)
    rows = jax.vmap(trajectories)(work.recorded)

    def env_of(part: Trajectories) -> TrackingEnv:
        return TrackingEnv(work.source, part, CONFIG)

    started = time.monotonic()
    init = jax.jit(jax.vmap(lambda key, part: agent.init(key, env_of(part), config)))
    step = jax.jit(jax.vmap(lambda state, part: agent.iterate(state, env_of(part), config)), donate_argnums=0)
    state, _ = loop.run(
        lambda s: step(s, rows),
        init(cell.keys("delta"), rows),
        settings.agent_iterations,
        title=f"{cell.method} {cell.samples}: following {len(cell.seeds)} logs",
        folder=work.folder / "grounding",
        identity={
            "cell": [cell.task, cell.method, cell.samples, cell.seeds, cell.backend, cell.dynamics],
            "config": dataclasses.asdict(config),
            "delta": dataclasses.asdict(CONFIG),
        },
        note=lambda metrics: f"return there {np.nanmean(np.append(metrics['return'], np.nan)):.1f}",
        quiet=work.quiet,
    )
    seconds = time.monotonic() - started
    steps = config.env_steps(settings.agent_iterations)
    actors = state.learner.actor
    learners = train(work, lambda actor: DeltaEnv(work.source, actor), actors)
    extra = [
        {"grounding_simulator_steps": steps, **_held_out_error(work, actors, i), **error}
        for i, error in enumerate(transform_errors(work, actors, partial(_transform_error, work)))
    ]
    return Trained(learners, work.log_sizes, extra, seconds)


def _transform_error(work: Work, key: jax.Array, actor: Actor, truth: Truth) -> jax.Array:
    return transform_error.in_rollouts(key, actor, work.source, truth, executed=delta_action.executed)


def _held_out_error(work: Work, actors: Actor, i: int) -> dict[str, Any]:
    actor = jax.tree.map(lambda x: x[i], actors)
    low, high = jnp.asarray(work.source.action_low), jnp.asarray(work.source.action_high)

    def error(rows: HeldOut) -> jax.Array:
        given = delta_action.executed(actor, rows.observation, rows.action, low, high)
        return prediction.error_under(work.source, rows, given)

    return prediction_error(work, error)
