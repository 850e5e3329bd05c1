"""What agents return in the simulators that they were trained in, beside what they return in the target.

python -m experiments.results.grounded_returns results/BrokenHopper-standard

An agent that returns more in its grounded simulator than in the target has learned from what is wrong there. How far
the transformers are from the target where the agents go is told too, where that is known. Reads the agents and
transformers that the cells of a sweep left, and writes grounded_returns.json into its folder.
"""

import sys
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import tyro

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from experiments.ending import exit_status
from experiments.results.sweeps import grounded_cells, keep_measured, read_json
from experiments.storage import SweepFolder, versions
from mpge_jax.grounding import transform_error
from mpge_jax.grounding.grounded_env import GroundedEnv
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.learning import agent, sac
from mpge_jax.rollouts.policies import PolicySet

NAME = "grounded_returns"


@dataclass(frozen=True)
class Args:
    """Evaluates a sweep's agents in the simulators that they were trained in."""

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(help="folder of a sweep")]
    episodes: Annotated[int, tyro.conf.arg(help="episodes of each agent in each simulator")] = 50

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ValueError(f"--episodes: at least one is needed, not {self.episodes}.")


def returns(
    key: jax.Array,
    source: envs.Env,
    truth: transform_error.Truth | None,
    agents: PolicySet,
    transformers: Transformer,
    episodes: int,
) -> dict[str, list[float]]:
    """Mean returns of S agents, stochastic as in the tables, in the simulator as it is and grounded; and the mean
    action-transformation error where they go, if the `truth` is known.

    Args:
      transformers: of each agent's ensemble, every leaf `[S, N, ...]`.
    """

    def each(key: jax.Array, actor: sac.Actor, members: Transformer) -> dict[str, jax.Array]:
        there = GroundedEnv(source, members)
        found = {
            name: agent.evaluate(key, env, actor, episodes, True).mean()
            for name, env in (("simulator", source), ("grounded", there))
        }
        if truth is not None:
            act = lambda obs, key: sac.act(actor, obs, key)  # noqa: E731
            errors = jax.vmap(lambda pi_g: transform_error.in_rollouts(key, pi_g, source, truth, act=act))
            found["error"] = errors(members).mean()
        return found

    found = jax.jit(jax.vmap(each))(jax.random.split(key, agents.size), agents.actor, transformers)
    return {name: np.asarray(values).tolist() for name, values in found.items()}


def measured(folder: Path, episodes: int) -> dict[str, Any]:
    """The returns of every cell of a sweep that has transformers and agents, and what they are of."""
    identity = read_json(folder / "sweep.json")["identity"]
    source = envs.make(envs.source_of(identity["task"]), identity["backend"], identity["dynamics"])
    truth = transform_error.truth_of(envs.make(identity["task"], identity["backend"], identity["dynamics"]))
    sweep, cells = SweepFolder(folder, identity), {}
    for method, samples, transformers in grounded_cells(sweep):
        agents = sweep.agents(method, samples)
        if agents is None:
            continue
        key = jax.random.key(zlib.crc32(f"grounded returns/{method}/{samples}".encode()))
        cells[f"{method}-{samples}"] = returns(key, source, truth, agents, transformers, episodes)
    return {"task": identity["task"], "episodes": episodes, "versions": versions(), "cells": cells}


def main() -> int:
    """The command; returns its exit status."""

    def work() -> int:
        args = tyro.cli(Args, prog="python -m experiments.results.grounded_returns", description=Args.__doc__)
        record = measured(args.folder, args.episodes)
        keep_measured(args.folder, NAME, record)
        print(f"written: {args.folder / NAME}.json")
        return 0

    return exit_status("grounded_returns", work, goes_on=False)


if __name__ == "__main__":
    sys.exit(main())
