"""DARC: agents trained in the simulator, with a reward that the target's log corrects."""

import dataclasses

import jax

from experiments.methods.cell import Trained, Work
from experiments.methods.training import first_learners, run_agents
from mpge_jax.learning import darc
from mpge_jax.learning.darc import DARCConfig, Rows
from mpge_jax.rollouts.trajectories import trajectories

WARM_UP = 0.1
"""Share of the updates before the reward is corrected, as in the paper (100,000 steps of a million)."""


def corrected_reward(work: Work) -> Trained:
    """Agents trained in the simulator by DARC."""
    settings = work.cell.preset.tasks[work.source.name]
    config = settings.agent
    classifiers = DARCConfig(batch_size=config.sac.batch_size)
    warm_up = round(WARM_UP * settings.agent_updates)
    logged = jax.vmap(trajectories)(work.recorded)
    rows = Rows(logged.observation, logged.action, logged.following)
    init = jax.jit(
        jax.vmap(lambda key, learner: darc.init_agent(key, work.source, config, classifiers, learner))
    )
    step = jax.jit(
        jax.vmap(
            lambda state, log, valid: darc.iterate(
                state, work.source, log, valid, config, classifiers, warm_up
            )
        ),
        donate_argnums=0,
    )
    state = run_agents(
        work,
        lambda s: step(s, rows, logged.count),
        init(work.cell.keys("agent"), first_learners(work)),
        settings.agent_iterations,
        {"agent": dataclasses.asdict(config), "darc": dataclasses.asdict(classifiers), "warm_up": warm_up},
    )
    return Trained(state.agent.learner, work.log_sizes, [{}] * len(work.cell.seeds))
