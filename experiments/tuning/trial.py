"""One transformer for each seed, grounded in a target with five policies: how far it is from the right one."""

import time
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import envs
from experiments.storage import plain, versions
from mpge_jax.grounding import ensemble, transform_error
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.rollouts import policies, target_log

SHARES = (0.25, 0.5, 1.0)
CURVES = {"errors": "error_uniform", "errors_own": "error_own"}


def trial(
    task: str, config: GroundingConfig, samples: int, seeds: int, title: str, backend: str = "auto"
) -> dict[str, Any]:
    """Errors at a quarter, half and the end of a run: `errors` under uniform random actions, `errors_own` under the
    policies' own, `[seeds]` each, means of the five iterations before.

    Args:
      task: name of the target; its source task's shipped `MS` set records and grounds.
      samples: transitions recorded in the target for each seed.
      title: of the progress bar.
      backend: physics (`envs.make`).
    """
    target, source = envs.make(task, backend), envs.make(envs.source_of(task), backend)
    rollout = policies.shipped(source.name, "MS")[0].rollout
    keys = jax.random.split(jax.random.key(0), seeds)
    sets = jax.tree.map(lambda x: jnp.stack([x] * seeds), rollout)
    logs = jax.vmap(lambda key, one: target_log.collect(key, target, one, samples))(keys, sets)
    started = time.monotonic()
    _, curve = ensemble.ground_ensemble(
        source,
        sets,
        logs,
        config,
        jax.random.split(jax.random.key(1), seeds),
        truth=transform_error.truth_of(target),
        title=title,
    )
    length = len(curve["error_uniform"])
    return {
        "task": task,
        "samples": samples,
        "iterations": length,
        "simulator_steps": length * config.simulator_steps,
        "config": plain(config),
        **{
            name: {str(share): _before(np.asarray(curve[of]), round(share * length)) for share in SHARES}
            for name, of in CURVES.items()
        },
        "seconds": round(time.monotonic() - started, 1),
        "versions": versions(),
    }


def _before(curve: np.ndarray, end: int) -> list[float]:
    return curve[max(0, end - 5) : end].mean(axis=0).round(4).tolist()


def spread(values: Sequence[float]) -> str:
    """Mean (least to most)."""
    return f"{np.mean(values):.3f} ({min(values):.3f} to {max(values):.3f})"
