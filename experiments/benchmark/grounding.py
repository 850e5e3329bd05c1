"""Grounding, learning included: whole iterations, and their stages."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from experiments.benchmark.clock import Row, measure, stepper
from mpge_jax.grounding import adversarial, collect, transformer
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.learning import trpo, value
from mpge_jax.learning.policy_gradient import PolicyBatch
from mpge_jax.rollouts import policies, target_log

STAGES = ("collection", "discriminator", "values", "TRPO")
SOURCE, TARGET = "HalfCheetah", "BrokenCheetah"
SAMPLES = 5_000
# Environment steps a second of the paper's released code while it grounds, learning included, on two CPU cores.
REFERENCE = 676.0


def measure_grounding(backend: str, members: int, config: GroundingConfig, seconds: float) -> Row:
    """Simulator steps a second of `members` transformers together: collection and every update of an iteration."""
    row = measure(iteration(backend, members, config), members * config.batch_size, seconds)
    return {
        "backend": backend,
        "members": members,
        "copies": config.num_envs,
        "batch": config.batch_size,
        **row,
    }


def iteration(
    backend: str,
    members: int,
    config: GroundingConfig,
    samples: int = SAMPLES,
    count: int = 5,
    tasks: tuple[str, str] = (SOURCE, TARGET),
) -> Callable[[], Any]:
    """A call of which makes one iteration of `members` transformers, begun where the last one ended.

    Args:
      backend: physics of the simulator.
      samples: transitions in the target's log.
      count: rollout policies; beyond the five that ship with a task they repeat.
      tasks: source and target.
    """
    source = envs.make(tasks[0], backend)
    shipped = policies.shipped(tasks[0], "MS")[0].rollout
    chosen = jnp.arange(count) % shipped.size
    rollout = shipped.replace(params=jax.tree.map(lambda x: x[chosen], shipped.params))
    target = envs.make(tasks[1], "c" if jax.default_backend() == "cpu" else backend)
    log = target_log.collect(jax.random.key(0), target, rollout, samples)
    keys = jax.random.split(jax.random.key(1), members)
    state = jax.jit(jax.vmap(lambda key: adversarial.init(key, source, rollout, log, config)))(keys)
    step = jax.jit(
        jax.vmap(lambda s: adversarial.update(s, source, rollout, log, config)[0]), donate_argnums=0
    )
    return stepper(step, state)


def measure_stage(stage: str, members: int, config: GroundingConfig, seconds: float) -> Row:
    """Iterations a second of one stage of grounding on the C engine, for `members` transformers together."""
    source = envs.make(SOURCE, "c")
    rollout = policies.shipped(SOURCE, "MS")[0].rollout
    log = target_log.collect(jax.random.key(0), envs.make(TARGET, "c"), rollout, SAMPLES)

    @jax.jit
    @jax.vmap
    def begin(key: jax.Array) -> Any:
        state = adversarial.init(key, source, rollout, log, config)
        begun = state.env_state, state.rollout_policy
        return state, collect.collect(key, state.current, begun, source, rollout, log, config)[1]

    keys = jax.random.split(jax.random.key(1), members)
    state, rows = begin(keys)

    def run(key: jax.Array, state: adversarial.GroundingState, rows: collect.Rows) -> Any:
        if stage == "collection":
            begun = state.env_state, state.rollout_policy
            return collect.collect(key, state.current, begun, source, rollout, log, config)
        if stage == "discriminator":
            return adversarial.update_discriminator(
                key, state.discriminator, rows.transitions, rows.rollout_policy, log, state.expected, config
            )
        inputs = transformer.network_inputs(state.transformer, rows.observation, rows.action)
        # Any numbers will do for rewards: the work is the same.
        if stage == "values":
            value_config = config.value(rollout.size)
            return value.update(state.value, inputs, rows.rollout_policy, rows.log_prob, key, value_config)
        batch = PolicyBatch(inputs, rows.delta, rows.log_prob, rows.log_prob)
        learner = trpo.TRPOState(state.policy.params)
        return trpo.update(learner, batch, key, transformer.apply, trpo.TRPOConfig())

    compiled = jax.jit(jax.vmap(run))
    row = measure(lambda: compiled(keys, state, rows), members, seconds)
    return {"stage": stage, "members": members, **row}
