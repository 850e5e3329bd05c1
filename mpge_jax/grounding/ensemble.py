"""Grounding from start to end: N transformers in one compiled step, in a loop that reports and can be resumed.

Shapes: `N` members; everything else as in `mpge_jax.grounding.adversarial`.
"""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from envs import Env
from mpge_jax import loop, sharding
from mpge_jax.grounding import adversarial, early_stop, inversion, transform_error
from mpge_jax.grounding.adversarial import GroundingState
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.early_stop import EarlyStop
from mpge_jax.grounding.inversion import InversionConfig
from mpge_jax.grounding.transform_error import Truth
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.loop import Curve
from mpge_jax.rollouts import target_log
from mpge_jax.rollouts.rollout import RolloutPolicies
from mpge_jax.rollouts.target_log import TargetLog


def ground(
    env: Env,
    rollout_policies: RolloutPolicies,
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
    _check_kinds(rollout_policies, target_log, config, key)
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
    rollout_policies: RolloutPolicies,
    logs: TargetLog,
    config: GroundingConfig,
    keys: jax.Array,
    *,
    truth: Truth | None = None,
    start: Transformer | None = None,
    stopping: EarlyStop | None = None,
    mesh: Mesh | None = None,
    folder: Path | str | None = None,
    quiet: bool = False,
    title: str = "grounding",
) -> tuple[Transformer, Curve]:
    """Learns N transformers, each from its own log, policies and key, in one compiled iteration.

    Args:
      env: the simulator.
      rollout_policies: the policies of each; every leaf `[N, K, ...]`.
      logs: every leaf `[N, ...]`.
      config: how to learn.
      keys: `[N]`, consumed.
      truth: the true change of actions, where it is known: the curve then has the action-transformation errors.
      start: transformers to go on from, every leaf `[N, ...]`; fresh ones where None.
      stopping: keeps rows of each log back, ends when they are predicted no better, and returns the best; else the
        last is returned.
      mesh: devices with the axes `members` and `environments` to spread the work over, see `mpge_jax.sharding`.
      folder: where checkpoints are kept, if anywhere.
      quiet: no progress bar.
      title: shown before the progress bar.

    Returns:
      The transformers, every leaf `[N, ...]`, and the curve, every metric `[iterations, N]`.

    Raises:
      ValueError: as `ground`.
    """
    _check_kinds(rollout_policies, logs, config, keys)
    starts = {} if start is None else {"starting transformers": start.input_mean}
    params = jax.tree.leaves(rollout_policies.params)[0]
    _check_stacked(keys, {"rollout policies": params, "target logs": logs.count, **starts})
    members = int(keys.shape[0])
    for member in range(members):
        one = lambda tree, m=member: jax.tree.map(lambda x: x[m], tree)  # noqa: E731
        one(rollout_policies).check_fits(env)
        target_log.validate(one(logs), env)

    def first(
        key: jax.Array, pi_g: Transformer | None, actors: RolloutPolicies, log: TargetLog, rows: Any
    ) -> Any:
        state = adversarial.init(key, env, actors, log, config, pi_g)
        return state if rows is None else early_stop.init(state, env, rows)

    def iterate(state: Any, actors: RolloutPolicies, log: TargetLog, rows: Any) -> Any:
        inner: GroundingState = state if rows is None else state.grounding
        key, key_error = jax.random.split(inner.key)
        inner, metrics = adversarial.update(inner.replace(key=key), env, actors, log, config)
        if rows is not None:
            state, more = early_stop.update(state, inner, env, rows)
            metrics |= more
        else:
            state = inner
        if truth is not None:
            metrics |= transform_error.on_log(key_error, state.result, env, truth, log)
        return state, metrics

    learned_from, held_out = logs, None
    if stopping is not None:
        learned_from, held_out = jax.vmap(stopping.hold_out)(logs)
    data = (rollout_policies, learned_from, held_out)
    state = jax.jit(jax.vmap(first))(keys, start, *data)
    if mesh is not None:
        state, data = sharding.place((state, data), mesh, config.num_envs)
    step = sharding.compile(jax.vmap(iterate), state, mesh)
    identity = {
        "config": dataclasses.asdict(config),
        "stopping": None if stopping is None else dataclasses.asdict(stopping),
        "env": env.name,
        "members": members,
        "keys": np.asarray(jax.random.key_data(keys)).tolist(),
        "log": _digest(logs),
        "policies": _digest(rollout_policies),
        "truth": truth is not None,
        "start": None if start is None else _digest(start),
    }

    def note(metrics: dict[str, np.ndarray]) -> str:
        if truth is None:
            return f"reward {metrics['reward'].mean():.2f}"
        return f"error {metrics['error_uniform'].mean():.3f} uniform, {metrics['error_own'].mean():.3f} own"

    state, curve = loop.run(
        lambda s: step(s, *data),
        state,
        config.iterations,
        title=title,
        folder=folder,
        identity=identity,
        note=note,
        stop=None if stopping is None else stopping.is_over,
        quiet=quiet,
    )
    return state.result, curve


def _check_kinds(policies: Any, log: Any, config: Any, key: Any) -> None:
    """Makes sure that what is given stands where it belongs."""
    given = (("rollout policies", policies, RolloutPolicies), ("target log", log, TargetLog))
    for name, value, kind in (*given, ("config", config, GroundingConfig)):
        if not isinstance(value, kind):
            raise ValueError(f"the {name} must be a {kind.__name__}, not {type(value).__name__}")
    if not isinstance(key, jax.Array):
        raise ValueError(f"the key must be one of JAX, as jax.random.key(0), not {type(key).__name__}")


def _check_stacked(keys: jax.Array, given: dict[str, jax.Array]) -> None:
    for name, array in given.items():
        if array.ndim < 2 or array.shape[0] != keys.shape[0]:
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
      ValueError: a log that does not fit `env` or of which no observation tells its state, or another number of logs
        than of keys.
    """
    if keys.ndim != 2:
        raise ValueError(f"invert_ensemble wants keys of shape [logs, members], got {keys.shape}")
    _check_stacked(keys, {"target logs": logs.count})
    for member in range(keys.shape[0]):
        target_log.validate(jax.tree.map(lambda x, m=member: x[m], logs), env)
    told = jax.jit(jax.vmap(jax.vmap(jax.vmap(env.tells_state))))(logs.observation)
    if not (told & logs.valid).any((1, 2)).all():
        raise ValueError(f"target log: no observation of {env.name} tells its state, which inversion needs")

    def one(key: jax.Array, log: TargetLog) -> tuple[Transformer, jax.Array]:
        inverted = inversion.invert(env, log, config)
        misfit = jnp.nanmedian(jnp.where(inverted.weight > 0, inverted.misfit, jnp.nan))
        return jax.vmap(lambda k: inversion.regress(k, inverted, config))(key), misfit

    return jax.jit(jax.vmap(one))(keys, logs)
