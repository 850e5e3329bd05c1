"""Agents of all seeds: trained where a method says, evaluated in the target."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import envs
from experiments.methods.cell import Cell, Work
from mpge_jax import loop
from mpge_jax.learning import agent
from mpge_jax.learning.sac import SACState
from mpge_jax.rollouts.policies import PolicySet


def first_learners(work: Work) -> SACState:
    """Learners that go on from the first policy of each seed's set, every leaf `[S, ...]`."""
    config = work.cell.preset.tasks[work.source.name].agent.sac
    count = len(work.cell.seeds)
    first = [jax.tree.map(lambda x, i=i: x[i], work.sets).learner(0, config) for i in range(count)]
    return jax.tree.map(lambda *x: jnp.stack(x), *first)


def train(work: Work, env_of: Callable[[Any], envs.Environment], given: Any = None) -> SACState:
    """Agents that go on from the first policy of each seed's set, every leaf `[S, ...]`.

    Args:
      work: the cell and its policies.
      env_of: where a seed's agent trains, from its part of `given`.
      given: every leaf `[S, ...]`.
    """
    settings = work.cell.preset.tasks[work.source.name]
    config = settings.agent
    init = jax.jit(jax.vmap(lambda key, learner, part: agent.init(key, env_of(part), config, learner)))
    step = jax.jit(jax.vmap(lambda state, part: agent.iterate(state, env_of(part), config)), donate_argnums=0)
    state = run_agents(
        work,
        lambda s: step(s, given),
        init(work.cell.keys("agent"), first_learners(work), given),
        settings.agent_iterations,
        dataclasses.asdict(config),
    )
    return state.learner


def run_agents(
    work: Work, step: Callable[[Any], Any], state: Any, iterations: int, config: dict[str, Any]
) -> Any:
    """The state after so many compiled iterations of all seeds, with checkpoints in the cell's folder.

    Args:
      work: the cell.
      step: one iteration, `state -> (state, metrics)`, of which `return` is shown.
      state: where training begins.
      iterations: how many.
      config: what the training is, JSON-serialisable.
    """
    cell = work.cell
    state, _ = loop.run(
        step,
        state,
        iterations,
        title=f"{cell.method} {cell.samples}: training {len(cell.seeds)} agents",
        folder=work.folder / "agent",
        identity={
            "cell": [cell.task, cell.method, cell.samples, cell.seeds, cell.backend, cell.dynamics],
            "config": config,
        },
        note=lambda metrics: (
            f"return there {np.nanmean(np.append(metrics['return'], np.nan)):.0f}"
            if np.isfinite(metrics["return"]).any()
            else ""
        ),
        quiet=work.quiet,
    )
    return state


def evaluate(cell: Cell, target: envs.Env, agents: PolicySet) -> dict[str, np.ndarray]:
    """Returns in the target, `[S, episodes]`, for reporting only."""
    episodes = cell.preset.episodes
    return {
        name: np.asarray(
            jax.jit(jax.vmap(lambda k, actor, s=stochastic: agent.evaluate(k, target, actor, episodes, s)))(
                cell.keys(f"evaluation {name}"), agents.actor
            )
        )
        for name, stochastic in (("return_stochastic", True), ("return_deterministic", False))
    }
