"""Sets of rollout policies, on disk and in memory.

A set is K trained SAC agents: several seeds (`MS`), or a sequence in which each is rewarded for the entropy of those
before it (`ER`). Files are plain npz in half precision: no pickles, no code.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import flax.struct
import flax.traverse_util
import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
from jaxtyping import Array, Float

import envs
from mpge_jax import files
from mpge_jax.learning import sac
from mpge_jax.learning.sac import Actor, SACConfig, SACState
from mpge_jax.rollouts.rollout import RolloutPolicies

KINDS = ("MS", "ER")
# Weight of the entropy bonus in the paper's text.
ER_COEFFICIENT = 0.1


def _rows(tree: Any, index: int | list[int]) -> Any:
    """`x[index]` of every leaf. By NumPy: JAX would compile a program for the shape of each."""
    return jax.tree.map(lambda x: jnp.asarray(np.asarray(x)[index]), tree)


class PolicySet(flax.struct.PyTreeNode):
    """K policies; every leaf has a leading axis K.

    Attributes:
      actor: parameters and action scale.
      critic: both critics of each.
      log_alpha: logarithm of the temperature.
    """

    actor: Actor
    critic: Any
    log_alpha: Float[Array, "*n K"]

    @property
    def size(self) -> int:
        return int(self.log_alpha.shape[0])

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""
        return self.actor.hidden

    @property
    def rollout(self) -> RolloutPolicies:
        """These policies as those that collect: their actions are sampled."""
        return RolloutPolicies(params=self.actor, act=sac.act)

    def select(self, indices: list[int]) -> "PolicySet":
        """The policies `indices`, in that order.

        Raises:
          ValueError: there is no such policy.
        """
        if not all(0 <= index < self.size for index in indices):
            raise ValueError(f"policies {list(indices)} were asked for, this set has 0 to {self.size - 1}")
        return _rows(self, list(indices))

    def learner(self, index: int, config: SACConfig) -> SACState:
        """A SAC learner that goes on from policy `index`: its actor, critics and temperature.

        Raises:
          ValueError: the configuration wants networks of other sizes.
        """
        one = _rows(self, index)
        return sac.warm_start(one.actor, one.critic, one.log_alpha, config)


def from_learners(state: SACState) -> PolicySet:
    """The set of K policies that a vmapped learner `[K, ...]` holds."""
    return PolicySet(state.actor, state.critic, state.log_alpha)


def mean_entropy(
    policies: PolicySet, weights: Float[Array, " K"], obs: Float[Array, " O"]
) -> Float[Array, ""]:
    """Mean Gaussian entropy before squashing of the policies with `weights` 1 at `obs`; 0 where there is none."""
    entropies = jax.vmap(lambda actor: sac.policy_entropy(actor, obs))(policies.actor)
    return jnp.sum(weights * entropies) / jnp.maximum(jnp.sum(weights), 1.0)


def entropy_bonus(
    coefficient: float, earlier: PolicySet, weights: Float[Array, " K"]
) -> Callable[[Float[Array, " O"]], Float[Array, ""]]:
    """What an entropy-regularised policy earns at an observation beside the task's reward: the MPGE paper's ER set.

    `coefficient` times the mean entropy there of the `earlier` policies with `weights` 1; nothing for the first.
    """
    return lambda obs: coefficient * mean_entropy(earlier, weights, obs)


def save(path: Path | str, policies: PolicySet, about: dict[str, Any]) -> None:
    """Writes a set and what there is to know about it (JSON-serialisable), atomically."""
    flat = flax.traverse_util.flatten_dict(
        {"actor": policies.actor.params, "critic": policies.critic}, sep="/"
    )
    arrays = {name: np.asarray(value, np.float16) for name, value in flat.items()}
    named = {
        "about": np.array(json.dumps(about)),
        "log_alpha": np.asarray(policies.log_alpha, np.float32),
        "action_scale": np.asarray(policies.actor.action_scale, np.float32),
        "action_middle": np.asarray(policies.actor.action_middle, np.float32),
    }
    files.write_npz(path, {**named, **arrays})


def load(path: Path | str) -> tuple[PolicySet, dict[str, Any]]:
    """Reads what `save` wrote.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: the file is damaged or is not a policy set.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no policy set at {path}; `python -m experiments.pretrain` makes one"
        )
    try:
        arrays = files.read_npz(path)
        about = json.loads(str(arrays.pop("about")))
        log_alpha, scale = arrays.pop("log_alpha"), arrays.pop("action_scale")
        # sets of before boxes could have their middle elsewhere
        middle = arrays.pop("action_middle", np.zeros_like(scale))
        nested = flax.traverse_util.unflatten_dict(
            {name: jnp.asarray(value, jnp.float32) for name, value in arrays.items()}, sep="/"
        )
        actor = Actor(nested["actor"], jnp.asarray(scale), jnp.asarray(middle))
        loaded = PolicySet(actor, nested["critic"], jnp.asarray(log_alpha))
        if {x.shape[0] for x in jax.tree.leaves(loaded)} != {loaded.size}:
            raise ValueError("its arrays do not belong to one number of policies")
        if not all(np.all(np.isfinite(x)) for x in jax.tree.leaves(loaded)):
            raise ValueError("a number in it is not finite")
        return loaded, about
    except Exception as error:
        raise ValueError(
            f"{path} is damaged or is not a policy set ({type(error).__name__}: {error})"
        ) from error


def save_checkpoint(folder: Path | str, policies: PolicySet) -> None:
    """Writes a set as an orbax checkpoint, in full precision and atomically, in place of one that is there."""
    tree = {
        "actor": policies.actor.params,
        "action_scale": policies.actor.action_scale,
        "action_middle": policies.actor.action_middle,
        "critic": policies.critic,
        "log_alpha": policies.log_alpha,
    }
    with ocp.StandardCheckpointer() as checkpointer:
        checkpointer.save(Path(folder).absolute(), jax.tree.map(np.asarray, tree), force=True)


def load_checkpoint(folder: Path | str) -> PolicySet:
    """Reads what `save_checkpoint` wrote.

    Raises:
      FileNotFoundError: there is no such folder.
      ValueError: it is damaged or holds something else.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no checkpoint of policies at {folder}")
    try:
        with ocp.StandardCheckpointer() as checkpointer:
            tree = checkpointer.restore(folder.absolute())
        scale = tree["action_scale"]
        actor = Actor(tree["actor"], scale, tree.get("action_middle", np.zeros_like(scale)))
        loaded = jax.tree.map(jnp.asarray, PolicySet(actor, tree["critic"], tree["log_alpha"]))
        if {x.shape[0] for x in jax.tree.leaves(loaded)} != {loaded.size}:
            raise ValueError("its arrays do not belong to one number of policies")
    except Exception as error:
        reason = " ".join(str(error).split())[:150]
        raise ValueError(
            f"{folder} is damaged or is no checkpoint of policies ({type(error).__name__}: {reason})"
        ) from error
    return loaded


def controller(
    folder: Path | str, index: int = 0
) -> Callable[[Float[np.ndarray, " O"]], Float[np.ndarray, " A"]]:
    """Policy `index` of a checkpoint, ready to act: `observation [O] -> action [A]`, the mode, in the actuators' units.

    Raises:
      FileNotFoundError, ValueError: as `load_checkpoint`, or there is no such policy.
    """
    actor = _rows(load_checkpoint(folder).select([index]).actor, 0)
    mode = jax.jit(sac.act)
    return lambda observation: np.asarray(mode(actor, jnp.asarray(observation, jnp.float32)))


def shipped_path(task: str, kind: str, entropy_coefficient: float = ER_COEFFICIENT) -> Path:
    """Where the set of a task lies: with the project, or beside the file of a task of the user's own.

    An ER set of another coefficient than 0.1 has it in its name.
    """
    suffix = "" if kind != "ER" or entropy_coefficient == ER_COEFFICIENT else f"-{entropy_coefficient:g}"
    home = envs.home_of(task) or Path(__file__).parents[1]
    return home / "policy_sets" / f"{task}-{kind}{suffix}.npz"


def shipped(
    task: str, kind: str, entropy_coefficient: float = ER_COEFFICIENT
) -> tuple[PolicySet, dict[str, Any]]:
    """The policies of a source task, five for those that ship with the project, and how they were made.

    Args:
      task: the source task.
      kind: `MS` or `ER`.
      entropy_coefficient: of an `ER` set: 0.1 (the paper's text) or 0.01 (its authors' code).

    Raises:
      ValueError: the kind or the task is not known, or the task is a target.
      FileNotFoundError: the task has no such set yet.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown kind of policy set {kind!r} (known: {', '.join(KINDS)})")
    if (source := envs.source_of(task)) != envs.plain_name(task):
        raise ValueError(f"{task} is a target; policies are trained in its source, {source}")
    path = shipped_path(source, kind, entropy_coefficient)
    if not path.is_file():
        file = "" if envs.home_of(source) is None else "FILE.py:"
        options = "" if kind == "MS" else f" --entropy-coefficient {entropy_coefficient:g}"
        raise FileNotFoundError(
            f"{source} has no {kind} set of policies yet; `python -m experiments.pretrain --task {file}{source} "
            f"--kind {kind}{options}` trains one"
        )
    return load(path)
