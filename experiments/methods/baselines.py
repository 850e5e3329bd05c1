"""Methods that learn no model of the target: the policy as it is, and agents that go on in the target itself."""

import dataclasses

import jax

from experiments.methods.cell import Trained, Work
from experiments.methods.training import first_learners, run_agents, train
from mpge_jax.learning import agent

UPDATES_A_STEP = 1
"""SAC updates of `finetune` after each step in the target: as many as in the paper's agent (Stable-Baselines3)."""


def direct(work: Work) -> Trained:
    """The source policy, as it is."""
    count = len(work.cell.seeds)
    return Trained(first_learners(work), [0] * count, [{}] * count)


def target(work: Work) -> Trained:
    """Trained on in the target, within the preset's budget."""
    settings = work.cell.preset.tasks[work.source.name]
    steps = settings.agent.env_steps(settings.agent_iterations)
    count = len(work.cell.seeds)
    return Trained(train(work, lambda _: work.live_target), [steps] * count, [{}] * count)


def finetune(work: Work) -> Trained:
    """SAC goes on in the target, for exactly the metered number of steps.

    One environment, `UPDATES_A_STEP` updates after each step. For its first steps, half of the budget and a batch at
    most, the policy acts and nothing is learned: a uniformly random start would spend the budget far from the policy.
    """
    settings = work.cell.preset.tasks[work.source.name]
    steps = work.cell.samples
    first = max(1, min(settings.agent.sac.batch_size, steps // 2))
    config = dataclasses.replace(
        settings.agent,
        num_envs=1,
        steps_per_iteration=1,
        updates_per_iteration=UPDATES_A_STEP,
        alternations=1,
        buffer_capacity=steps,
        random_steps=first,
    )
    init = jax.jit(
        jax.vmap(lambda key, learner: agent.init(key, work.live_target, config, learner, first="policy"))
    )
    step = jax.jit(jax.vmap(lambda state: agent.iterate(state, work.live_target, config)), donate_argnums=0)
    state = run_agents(
        work,
        step,
        init(work.cell.keys("agent"), first_learners(work)),
        steps - first,
        dataclasses.asdict(config),
    )
    count = len(work.cell.seeds)
    return Trained(state.learner, [config.env_steps(steps - first)] * count, [{}] * count)
