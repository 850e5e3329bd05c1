"""Grounding from recordings of a real target: what is read of them, and how a simulator is judged by them.

Nothing acts in the target, so there is no return there. A simulator is judged by how well it predicts transitions of
the log that nothing was learned from.
"""

import functools
import zlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.methods.cell import Cell, LogFiles, Method, Work
from mpge_jax.diagnosis import InputError, load_readers
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.prediction import HeldOut
from mpge_jax.recorded import transitions
from mpge_jax.recorded.behaviour import behaviour
from mpge_jax.recorded.transitions import Recorded, Transitions
from mpge_jax.rollouts.rollout import RolloutPolicies
from mpge_jax.rollouts.target_log import TargetLog

LOGGED_STEPS = 2
"""Length of the episodes in which simulators are grounded: they begin in logged states, as the log need not begin where
the task does, and a discriminator would tell the two by the states alone."""
JUDGED = 4096
"""Most transitions that judge, spread evenly over those held out."""


@functools.lru_cache(maxsize=4)
def read(files: LogFiles, task: str) -> Recorded:
    """The transitions of a log; read once in a process.

    Raises:
      ValueError: it cannot be used; says what to do.
    """
    try:
        for file in files.readers:
            load_readers(file)
        return transitions.read(files.paths, task, files.model, files.map)
    except InputError as error:
        raise ValueError(f"--target-log: {error}") from None


def told(files: LogFiles, task: str) -> list[str]:
    """What there is to say of a log before it is learned from."""
    found = read(files, task)
    sizes = f"{found.train.size} transitions to learn from, {found.held.size} held out"
    return [f"log: {sizes}", *found.notes]


def fingerprint(files: LogFiles) -> dict[str, Any]:
    """What tells a log from another: the contents of its files, and of those that say how to read them."""

    def contents(path: Path) -> int:
        total = 0
        inside = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        for file in inside:
            with file.open("rb") as opened:
                while block := opened.read(1 << 20):
                    total = zlib.crc32(block, total)
        return total

    one = {name: contents(p) for name, p in (("model", files.model), ("map", files.map)) if p is not None}
    readers = {"readers": [contents(path) for path in files.readers]} if files.readers else {}
    return {"recordings": [contents(path) for path in files.paths], **one, **readers}


def checked_samples(asked: Iterable[int], available: int) -> list[int]:
    """The sizes of logs that are asked for; all transitions where none is.

    Raises:
      ValueError: there are fewer.
    """
    sizes = sorted(set(asked)) or [available]
    if sizes[-1] > available:
        raise ValueError(
            f"--samples {sizes[-1]} is more than the log has to learn from: {available} transitions (others are held "
            "out); leave --samples out to take all"
        )
    return sizes


def part_of(cell: Cell, method: Method, source: str) -> tuple[TargetLog, RolloutPolicies]:
    """The log of a cell, and what acted in it, every leaf `[S, ...]`: the same for all seeds."""
    assert cell.files is not None
    parts = cell.preset.policies if method.several_policies else 1
    log = read(cell.files, source).train.log(cell.samples, parts)
    count = len(cell.seeds)
    return jax.tree.map(lambda x: jnp.repeat(x[None], count, axis=0), (log, behaviour(log)))


def held_out(t: Transitions) -> HeldOut:
    """Transitions that judge."""
    rows = np.unique(np.linspace(0, t.size - 1, min(JUDGED, t.size)).round().astype(int))
    observation, action, following = (
        jnp.asarray(x[rows], jnp.float32) for x in (t.observation, t.action, t.following)
    )
    return HeldOut(observation, action, following, jnp.ones(len(rows), jnp.float32))


def in_logged_states(work: Work, config: GroundingConfig | None) -> GroundingConfig | None:
    """A grounding whose episodes begin in states of a recorded log, where the task can be put into them."""
    if config is None or work.behaviour is None or work.source.task.to_state is None:
        return config
    return replace(config, restart_steps=config.restart_steps or LOGGED_STEPS)


def prediction_error(work: Work, error: Callable[[HeldOut], jax.Array]) -> dict[str, float]:
    """`held_out_error`, the mean of what `error` gives; nothing where no log was recorded, or none can be judged by."""
    if work.held_out is None or work.source.task.to_state is None:
        return {}
    return {"held_out_error": float(jnp.mean(jax.jit(error)(work.held_out)))}
