"""The policies that a cell starts from, and what they record in the target."""

from pathlib import Path

import jax
import jax.numpy as jnp

import envs
from experiments.methods.cell import Cell, Method
from experiments.presets import Preset
from mpge_jax.rollouts import policies, target_log
from mpge_jax.rollouts.policies import PolicySet
from mpge_jax.rollouts.target_log import TargetLog


def rollout_policies(cell: Cell, method: Method) -> int:
    """K: how many policies record, and are grounded with."""
    return cell.preset.policies if method.several_policies else 1


def policy_set(source: str, kind: str, preset: Preset) -> PolicySet:
    """The rollout policies of a preset.

    Raises:
      FileNotFoundError: there is no set of that kind and entropy coefficient.
      ValueError: the set was made with another coefficient than it should.
    """
    full, about = policies.shipped(source, kind, preset.entropy_coefficient)
    made_with = about.get("entropy_coefficient", preset.entropy_coefficient)
    if kind == "ER" and made_with != preset.entropy_coefficient:
        raise ValueError(
            f"the ER set of {source} was made with an entropy coefficient of {made_with}, "
            f"preset {preset.name} wants {preset.entropy_coefficient}"
        )
    return full


def record(cell: Cell, method: Method, target: envs.Env, sets: PolicySet, folder: Path) -> TargetLog:
    """The target logs, every leaf `[S, ...]`; recorded once, then read: a resumed cell takes no more target steps."""
    paths = [folder / f"target_log_{seed}.npz" for seed in cell.seeds]
    if all(path.is_file() for path in paths):
        return jax.tree.map(lambda *x: jnp.stack(x), *map(target_log.load, paths))
    collect = jax.vmap(lambda key, one: target_log.collect(key, target, one, cell.samples))
    logs = collect(cell.keys("log", method.kind, str(rollout_policies(cell, method))), sets.rollout)
    for i, path in enumerate(paths):
        target_log.save(path, jax.tree.map(lambda x, i=i: x[i], logs))
    return logs


def sets_of(cell: Cell, method: Method, source: str) -> PolicySet:
    """The policies of each seed, every leaf `[S, K, ...]`: seed i has those from number i on, in a circle.

    Raises:
      ValueError: the set has fewer than K.
    """
    full, wanted = policy_set(source, method.kind, cell.preset), rollout_policies(cell, method)
    if full.size < wanted:
        raise ValueError(
            f"the {method.kind} set of {source} has {full.size} policies, and preset {cell.preset.name} records with "
            f"{wanted}; train as many with `python -m experiments.pretrain --count {wanted}`"
        )
    rotation = [[(seed + k) % full.size for k in range(wanted)] for seed in cell.seeds]
    return jax.tree.map(lambda *x: jnp.stack(x), *(full.select(indices) for indices in rotation))
