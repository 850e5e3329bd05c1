"""A delta action model from the log, and agents trained in the simulator with it."""

import dataclasses
import time
from dataclasses import replace

import jax
import numpy as np

from experiments.methods.cell import Trained, Work
from experiments.methods.training import train
from mpge_jax import loop
from mpge_jax.grounding.delta_action import DeltaConfig, DeltaEnv, TrackingEnv
from mpge_jax.learning import agent
from mpge_jax.rollouts.trajectories import Trajectories, trajectories

CONFIG = DeltaConfig()
TEMPERATURE = 0.1
"""Where SAC's temperature starts: a step of following is worth 1 at most, less than the tasks' own rewards."""


def delta(work: Work) -> Trained:
    """Learns to follow the log, with the budget that the preset gives to an agent; then trains agents."""
    cell, settings = work.cell, work.cell.preset.tasks[work.source.name]
    config = replace(settings.agent, sac=replace(settings.agent.sac, init_alpha=TEMPERATURE))
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
    learners = train(work, lambda actor: DeltaEnv(work.source, actor), state.learner.actor)
    return Trained(
        learners, work.log_sizes, [{"grounding_simulator_steps": steps}] * len(cell.seeds), seconds
    )
