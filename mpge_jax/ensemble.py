"""Grounding from start to end: N transformers in one compiled step, in a loop that reports and can be resumed.

Shapes: `N` members; everything else as in `mpge_jax.grounding`.
"""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs import Env
from mpge_jax import grounding, inversion, loop, target_log, transform_error
from mpge_jax.grounding import GroundingState
from mpge_jax.grounding_config import GroundingConfig
from mpge_jax.inversion import InversionConfig
from mpge_jax.loop import Curve
from mpge_jax.policies import PolicySet
from mpge_jax.target_log import TargetLog
from mpge_jax.transform_error import Truth
from mpge_jax.transformer import Transformer


def ground(
    env: Env,
    rollout_policies: PolicySet,
    target_log: TargetLog,
    config: GroundingConfig,
    key: jax.Array,
    **options: Any,
) -> tuple[Transformer, Curve]:
    """Learns one action transformer.

    Args:
      env: the simulator.
      rollout_policies: the K policies that recorded the log.
      target_log: their transitions in the target.
      config: how to learn.
      key: consumed.
      **options: `truth`, `start`, `folder`, `quiet`, `title` of `ground_ensemble`.

    Returns:
      The transformer and its training curve, every metric `[iterations]`.

    Raises:
      ValueError: a log that does not fit `env` or the policies, or a checkpoint in `folder` of another run.
    """
    one = lambda tree: jax.tree.map(lambda x: x[None], tree)  # noqa: E731
    if options.get("start") is not None:
        options["start"] = one(options["start"])
    transformers, curve = ground_ensemble(
        env, one(rollout_policies), one(target_log), config, key[None], **options
    )
    first = lambda tree: jax.tree.map(lambda x: x[0], tree)  # noqa: E731
    return first(transformers), {name: values[:, 0] for name, values in curve.items()}


def ground_ensemble(
    env: Env,
    rollout_policies: PolicySet,
    logs: TargetLog,
    config: GroundingConfig,
    keys: jax.Array,
    *,
    truth: Truth | None = None,
    start: Transformer | None = None,
    folder: Path | str | None = None,
    quiet: bool = False,
    title: str = "grounding",
) -> tuple[Transformer, Curve]:
    """Learns N transformers, each from its own log, policies and key, in one compiled iteration.

    Args:
      env: the simulator.
      rollout_policies: every leaf `[N, K, ...]`.
      logs: every leaf `[N, ...]`.
      config: how to learn.
      keys: `[N]`, consumed.
      truth: the true change of actions, where it is known: the curve then has the action-transformation errors.
      start: transformers to go on from, every leaf `[N, ...]`; fresh ones where None.
      folder: where checkpoints are kept, if anywhere.
      quiet: no progress bar.
      title: shown before the progress bar.

    Returns:
      The transformers, every leaf `[N, ...]`, and the curve, every metric `[iterations, N]`.

    Raises:
      ValueError: as `ground`.
    """
    starts = {} if start is None else {"starting transformers": start.input_mean}
    _check_stacked(
        keys, {"rollout policies": rollout_policies.log_alpha, "target logs": logs.count, **starts}
    )
    rollout_policies.check_fits(env, config.rollout)
    for member in range(keys.shape[0]):
        target_log.validate(jax.tree.map(lambda x, m=member: x[m], logs), env)
    actors = rollout_policies.actor

    def first(key: jax.Array, actor: Any, log: TargetLog, pi_g: Transformer | None) -> GroundingState:
        return grounding.init(key, env, actor, log, config, pi_g)

    def iterate(state: GroundingState, actor: Any, log: TargetLog) -> Any:
        key, key_error = jax.random.split(state.key)
        state, metrics = grounding.update(state.replace(key=key), env, actor, log, config)
        if truth is not None:
            metrics |= transform_error.on_log(key_error, state.result, env, truth, log)
        return state, metrics

    state = jax.jit(jax.vmap(first, in_axes=(0, 0, 0, None if start is None else 0)))(
        keys, actors, logs, start
    )
    step = jax.jit(jax.vmap(iterate), donate_argnums=0)
    identity = {
        "config": dataclasses.asdict(config),
        "env": env.name,
        "members": int(keys.shape[0]),
        "keys": np.asarray(jax.random.key_data(keys)).tolist(),
        "log": _digest(logs),
        "policies": _digest(actors),
        "truth": truth is not None,
        "start": start is not None,
    }

    def note(metrics: dict[str, np.ndarray]) -> str:
        if truth is None:
            return f"reward {metrics['reward'].mean():.2f}"
        return f"error {metrics['error_uniform'].mean():.3f} uniform, {metrics['error_own'].mean():.3f} own"

    state, curve = loop.run(
        lambda s: step(s, actors, logs),
        state,
        config.iterations,
        title=title,
        folder=folder,
        identity=identity,
        note=note,
        quiet=quiet,
    )
    return state.result, curve


def _check_stacked(keys: jax.Array, given: dict[str, jax.Array]) -> None:
    for name, array in given.items():
        if array.ndim != 2 or array.shape[0] != keys.shape[0]:
            raise ValueError(
                f"{keys.shape[0]} keys ask for as many {name}, stacked on a first axis; "
                f"theirs are of shape {array.shape}"
            )


def _digest(tree: Any) -> str:
    """Tells apart the data of two runs."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(tree):
        digest.update(np.asarray(leaf).tobytes())
    return digest.hexdigest()


def invert_ensemble(
    env: Env, logs: TargetLog, config: InversionConfig, keys: jax.Array
) -> tuple[Transformer, jax.Array]:
    """Transformers by supervised inversion of the simulator: M of each of N logs, which is inverted once.

    Args:
      env: the simulator.
      logs: every leaf `[N, ...]`.
      config: how to invert and regress.
      keys: `[N, M]`, consumed.

    Returns:
      The transformers, every leaf `[N, M, ...]`, and the median misfit of each inversion, `[N]`.

    Raises:
      ValueError: a log that does not fit `env`, or another number of logs than of keys.
    """
    if keys.ndim != 2:
        raise ValueError(f"invert_ensemble wants keys of shape [logs, members], got {keys.shape}")
    _check_stacked(keys, {"target logs": logs.count})
    for member in range(keys.shape[0]):
        target_log.validate(jax.tree.map(lambda x, m=member: x[m], logs), env)

    def one(key: jax.Array, log: TargetLog) -> tuple[Transformer, jax.Array]:
        inverted = inversion.invert(env, log, config)
        misfit = jnp.nanmedian(jnp.where(inverted.weight > 0, inverted.misfit, jnp.nan))
        return jax.vmap(lambda k: inversion.regress(k, inverted, config))(key), misfit

    return jax.jit(jax.vmap(one))(keys, logs)
