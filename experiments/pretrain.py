"""Trains sets of source policies: `python -m experiments.pretrain --task HalfCheetah --kind MS`.

All seeds of an MS set are one vmapped compiled program. An ER set is a sequence: each policy is rewarded for the mean
entropy of those before it (the first of them is the MS set's first, which is trained the same way). Of each policy
the best moment of its training is kept, by deterministic episodes in the source. Interrupted runs go on where they
stopped.
"""

import dataclasses
import platform
import sys
import time
import zlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments.ending import exit_status
from mpge_jax import own_envs as own_envs  # isort: split

import envs
from envs import select
from mpge_jax import files, loop
from mpge_jax.learning import agent
from mpge_jax.learning.agent import AgentConfig, AgentState
from mpge_jax.learning.sac import SACConfig, SACState
from mpge_jax.rollouts import policies
from mpge_jax.rollouts.policies import PolicySet

EPISODES = 50
# A policy that hops swings between hardly and very well as it learns: which moment to keep is looked up this often.
ITERATIONS_BETWEEN_TRIALS = 16
TRIAL_EPISODES = 20

# Chosen for two cores: small batches with high learning rates, four fresh transitions an update.
_FAST = SACConfig(actor_lr=1e-3, critic_lr=1e-3, alpha_lr=1e-3, batch_size=128)
CONFIGS = {
    "HalfCheetah": AgentConfig(sac=_FAST, buffer_capacity=500_000),
    "Hopper": AgentConfig(sac=_FAST, buffer_capacity=300_000),
    "InvertedPendulum": AgentConfig(sac=_FAST, buffer_capacity=100_000, random_steps=1_000),
}
UPDATES = {"HalfCheetah": 65_536, "Hopper": 118_784, "InvertedPendulum": 12_288}
# Of a task of one's own.
OTHER, OTHER_UPDATES = AgentConfig(sac=_FAST, buffer_capacity=500_000), 65_536


class Training(flax.struct.PyTreeNode):
    """`M` policies in training, and each one's best moment so far.

    Attributes:
      agents: the trainings `[M, ...]`.
      best: learners `[M, ...]` as they were at their best trial.
      best_return: mean return of that trial `[M]`, -inf before the first.
      iteration: iterations done.
    """

    agents: AgentState
    best: SACState
    best_return: jax.Array
    iteration: jax.Array


@dataclass(frozen=True)
class Args:
    """Trains a set of source policies, which replaces the shipped one or lies beside the file of your own task.

    Attributes:
      task: HalfCheetah, Hopper, InvertedPendulum, or path/to/file.py:NAME for a task of your own.
      kind: MS (independent seeds) or ER (entropy-regularised, in sequence).
      count: policies of the set.
      updates: SAC updates for each policy; the task's own budget where None.
      entropy_coefficient: weight of the ER bonus (0.1 in the paper's text, 0.01 in its release).
      seed: of the whole set.
      out: folder for the set and the checkpoints; where None, the set replaces the shipped one, or lies beside the
        file of your own task.
      quiet: no progress.
    """

    task: str = "InvertedPendulum"
    kind: Literal["MS", "ER"] = "MS"
    count: int = 5
    updates: int | None = None
    entropy_coefficient: float = policies.ER_COEFFICIENT
    seed: int = 0
    out: Path | None = None
    quiet: bool = False


def train(args: Args, folder: Path) -> tuple[PolicySet, dict[str, Any]]:
    """Trains the set; returns it with an account of how (returns are measured after storage's rounding)."""
    env = envs.make(args.task)
    config = CONFIGS.get(env.name, OTHER)
    updates = UPDATES.get(env.name, OTHER_UPDATES) if args.updates is None else args.updates
    # to the next trial: what is learned after the last one would be lost
    between = ITERATIONS_BETWEEN_TRIALS * config.updates_per_iteration
    iterations = -(-updates // between) * ITERATIONS_BETWEEN_TRIALS
    started = time.time()
    keys = jax.random.split(jax.random.key(args.seed), args.count)
    train_set = _train_ms if args.kind == "MS" else _train_er
    result = train_set(args, env, config, keys, iterations, folder)
    about = {
        "task": env.name,
        "kind": args.kind,
        "seed": args.seed,
        "updates": iterations * config.updates_per_iteration,
        "env_steps": config.env_steps(iterations),
        "entropy_coefficient": args.entropy_coefficient if args.kind == "ER" else 0.0,
        "config": dataclasses.asdict(config),
        "kept": f"best of {iterations // ITERATIONS_BETWEEN_TRIALS} trials of {TRIAL_EPISODES} episodes in the source",
        "seconds_of_last_run": round(time.time() - started),
        "machine": f"{platform.machine()}, {jax.default_backend()}, jax {jax.__version__}",
    }
    return result, about


def returns_of(result: PolicySet, env: envs.Env, config: SACConfig, seed: int) -> dict[str, list[float]]:
    """Mean return of each policy over 50 episodes, deterministic and stochastic."""
    keys = jax.random.split(jax.random.key(seed), result.size)
    measured = {}
    for name, stochastic in (("deterministic", False), ("stochastic", True)):
        evaluate = jax.jit(jax.vmap(lambda k, a, s=stochastic: agent.evaluate(k, env, a, EPISODES, s).mean()))
        measured[name] = [round(float(x), 1) for x in evaluate(keys, result.actor)]
    return measured


def begin(agents: AgentState) -> Training:
    """The start of a training whose agents `[M, ...]` have not learned yet."""
    # Copied: both are donated to the first iteration.
    best = jax.tree.map(jnp.copy, agents.learner)
    return Training(
        agents, best, jnp.full(agents.last_return.shape[0], -jnp.inf, jnp.float32), jnp.zeros((), jnp.int32)
    )


def iterate(
    state: Training, env: envs.Env, config: AgentConfig, bonus: agent.RewardBonus | None = None
) -> tuple[Training, dict[str, jax.Array]]:
    """One iteration of every agent, and a trial of each where one is due; metrics `[M]` with `best_return`."""
    agents, metrics = jax.vmap(lambda one: agent.iterate(one, env, config, bonus))(state.agents)
    iteration = state.iteration + 1

    def trial(best: SACState, best_return: jax.Array) -> tuple[SACState, jax.Array]:
        # The same starts every time, so that moments differ by the policy alone.
        returns = jax.vmap(
            lambda actor: agent.evaluate(jax.random.key(0), env, actor, TRIAL_EPISODES).mean()
        )(agents.learner.actor)
        better = returns > best_return
        return select(better, (agents.learner, returns), (best, best_return))

    best, best_return = jax.lax.cond(
        iteration % ITERATIONS_BETWEEN_TRIALS == 0, trial, lambda *kept: kept, state.best, state.best_return
    )
    return Training(agents, best, best_return, iteration), {**metrics, "best_return": best_return}


def _train_ms(
    args: Args, env: envs.Env, config: AgentConfig, keys: jax.Array, iterations: int, folder: Path
) -> PolicySet:
    init = jax.jit(lambda keys: begin(jax.vmap(lambda key: agent.init(key, env, config))(keys)))
    update = jax.jit(lambda state: iterate(state, env, config), donate_argnums=0)
    state, _ = loop.run(
        update, init(keys), iterations, **_loop_options(args, folder / f"{env.name}-MS", "MS", config)
    )
    return policies.from_learners(state.best)


def _train_er(
    args: Args, env: envs.Env, config: AgentConfig, keys: jax.Array, iterations: int, folder: Path
) -> PolicySet:
    first, _ = policies.load(_set_path(args, "MS"))
    done = first.select([0])
    # The set so far, padded to its final size, so that every member of the sequence runs the same program.
    padded = first.select([0] * args.count)

    bonus = partial(policies.entropy_bonus, args.entropy_coefficient)

    def start(key: jax.Array, earlier: PolicySet, weights: jax.Array) -> Training:
        new = agent.init(key, env, config, bonus=bonus(earlier, weights))
        return begin(jax.tree.map(lambda x: x[None], new))

    def update(
        state: Training, earlier: PolicySet, weights: jax.Array
    ) -> tuple[Training, dict[str, jax.Array]]:
        return iterate(state, env, config, bonus(earlier, weights))

    compiled_start, compiled_update = jax.jit(start), jax.jit(update, donate_argnums=0)
    for index in range(1, args.count):
        weights = (jnp.arange(args.count) < index).astype(jnp.float32)
        state, _ = loop.run(
            partial(compiled_update, earlier=padded, weights=weights),
            compiled_start(keys[index], padded, weights),
            iterations,
            **_loop_options(
                args, folder / f"{env.name}-ER-{index}", f"ER {index + 1}/{args.count}", config, padded
            ),
        )
        new = policies.from_learners(state.best)
        done = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), done, new)
        padded = jax.tree.map(lambda all_, one, i=index: all_.at[i].set(one[0]), padded, new)
    return done


def _loop_options(
    args: Args, folder: Path, label: str, config: AgentConfig, earlier: PolicySet | None = None
) -> dict[str, Any]:
    identity: dict[str, Any] = {
        "args": dataclasses.asdict(dataclasses.replace(args, quiet=False, out=None)),
        "config": config,
    }
    if earlier is not None:
        leaves = (np.asarray(x).tobytes() for x in jax.tree.leaves(earlier))
        identity["earlier policies"] = zlib.crc32(b"".join(leaves))
    return {
        "title": f"{args.task} {label}",
        "folder": folder,
        "identity": identity,
        "seconds_between_checkpoints": 120.0,
        "note": lambda metrics: f"best {np.round(metrics['best_return'])}, now {np.round(metrics['return'])}",
        "quiet": args.quiet,
    }


def _set_path(args: Args, kind: str) -> Path:
    shipped = policies.shipped_path(envs.plain_name(args.task), kind, args.entropy_coefficient)
    return shipped if args.out is None else args.out / shipped.name


def main(args: Args) -> None:
    """Trains, stores, measures what was stored, and says it."""
    name = envs.plain_name(args.task)
    if name in envs.names() and envs.source_of(name) != name:
        raise ValueError(f"{name} is a target; policies are trained in its source, {envs.source_of(name)}")
    for what, number in (("--count", args.count), ("--updates", args.updates)):
        if number is not None and number < 1:
            raise ValueError(f"{what} must be at least 1, got {number}")
    print(CONFIGS.get(name, OTHER))
    folder, path = (Path("runs") if args.out is None else args.out) / "pretrain", _set_path(args, args.kind)
    with files.held(folder):
        result, about = train(args, folder)
    policies.save(path, result, about)
    stored, _ = policies.load(path)
    about["returns"] = returns_of(stored, envs.make(name), CONFIGS.get(name, OTHER).sac, args.seed + 1)
    policies.save(path, stored, about)
    print(f"{path}\n{about}")


def command() -> int:
    """The command; returns its exit status."""

    def work() -> int:
        main(tyro.cli(Args, prog="python -m experiments.pretrain"))
        return 0

    return exit_status("pretrain", work)


if __name__ == "__main__":
    sys.exit(command())
