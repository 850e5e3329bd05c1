"""A cell of the comparison: what decides its result, what a method is given, and what it gives back.

Shapes: `S` seeds, `K` rollout policies, `N` transformers of a seed.
"""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

import envs
from experiments.presets import Preset
from mpge_jax.grounding.prediction import HeldOut
from mpge_jax.grounding.transform_error import Truth
from mpge_jax.grounding.transformer import Transformer
from mpge_jax.learning.sac import SACState
from mpge_jax.loop import Curve
from mpge_jax.rollouts.policies import PolicySet
from mpge_jax.rollouts.rollout import RolloutPolicies
from mpge_jax.rollouts.target_log import TargetLog


@dataclass(frozen=True)
class LogFiles:
    """A recorded log in place of a simulated target.

    Attributes:
      paths: files and folders of recordings.
      model: of the machine in them, where that is not the task's own.
      map: file that renames and converts columns.
      readers: files that register readers for such logs.
    """

    paths: tuple[Path, ...]
    model: Path | None = None
    map: Path | None = None
    readers: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Cell:
    """One entry of the comparison: everything that decides its result."""

    task: str
    method: str
    samples: int
    seeds: tuple[int, ...]
    preset: Preset
    backend: str
    dynamics: str
    files: LogFiles | None = None

    def keys(self, stage: str, *shared: str) -> jax.Array:
        """A key for each seed, `[S]`, for one stage of the work.

        It depends on `shared` and not on the method where given: methods with the same policies get the same log.
        """
        label = "/".join((stage, *(shared or (self.method,)), str(self.samples)))
        root = jax.random.key(zlib.crc32(label.encode()))
        return jnp.stack([jax.random.fold_in(root, seed) for seed in self.seeds])


@dataclass(frozen=True)
class Outcome:
    """What a cell gave.

    Attributes:
      rows: one dict of results for each seed.
      grounding_seconds: what making the transformers took, of all seeds together.
      curve: of the grounding, every metric `[iterations, S, N]`, or empty.
      transformers: every leaf `[S, N, ...]`, or None.
      agents: the deployed policies, S of them.
    """

    rows: list[dict[str, Any]]
    grounding_seconds: float
    curve: Curve
    transformers: Transformer | None
    agents: PolicySet


@dataclass(frozen=True)
class Work:
    """What a method is given.

    Attributes:
      cell: what is asked.
      method: which one it is.
      source, target: the simulator, and what a policy is carried to; None where that is known by a log alone.
      sets: the policies of each seed, every leaf `[S, K, ...]`.
      logs: what they recorded in the target, every leaf `[S, ...]`; None for a method that asks for no log.
      folder: where it may keep what it needs to be resumed.
      truth: the change of actions that makes the source move as the target, where it is known; for reporting only.
      quiet: no progress bars.
      behaviour: what acted in a recorded log, every leaf `[S, K, ...]`; None where the policies of `sets` did.
      held_out: transitions of a recorded log that nothing is learned from; for reporting only.
      threads: that a diagnosis may take.
    """

    cell: Cell
    method: "Method"
    source: envs.Env
    target: envs.Env | None
    sets: PolicySet
    logs: TargetLog | None
    folder: Path
    truth: Truth | None = None
    quiet: bool = False
    behaviour: RolloutPolicies | None = None
    held_out: HeldOut | None = None
    threads: int = 1

    @property
    def live_target(self) -> envs.Env:
        """The target of a method that acts in it."""
        assert self.target is not None
        return self.target

    @property
    def recorded(self) -> TargetLog:
        """The logs of a method that asked for them."""
        assert self.logs is not None
        return self.logs

    @property
    def log_sizes(self) -> list[int]:
        """Target transitions in the log of each seed."""
        return [int(np.sum(np.asarray(count))) for count in self.recorded.count]

    def only(self, i: int) -> "Work":
        """The part of seed number `i`."""
        seed = self.cell.seeds[i]
        sets, logs, behaviour = jax.tree.map(lambda x: x[i : i + 1], (self.sets, self.logs, self.behaviour))
        cell = replace(self.cell, seeds=(seed,))
        folder = self.folder / f"seed_{seed}"
        return replace(self, cell=cell, sets=sets, logs=logs, behaviour=behaviour, folder=folder)


@dataclass(frozen=True)
class Trained:
    """What a method gives back.

    Attributes:
      learners: the agents, every leaf `[S, ...]`.
      target_steps: steps that each seed took in the target.
      extra: further results of each seed, for its row.
      seconds: what it took before agents were trained.
      curve: of the grounding, every metric `[iterations, S, N]`, or empty.
      transformers: every leaf `[S, N, ...]`, or None.
    """

    learners: SACState
    target_steps: list[int]
    extra: list[dict[str, Any]]
    seconds: float = 0.0
    curve: Curve = field(default_factory=dict)
    transformers: Transformer | None = None

    @staticmethod
    def joined(parts: Sequence["Trained"]) -> "Trained":
        """Seeds that were treated one after the other, as one."""

        def together(trees: list[Any]) -> Any:
            return jax.tree.map(lambda *x: jnp.concatenate(x), *trees)

        made = [part.transformers for part in parts]
        # An error is known only where the simulator was left as it is.
        known = [name for name in parts[0].curve if all(name in part.curve for part in parts)]
        return Trained(
            learners=together([part.learners for part in parts]),
            target_steps=[steps for part in parts for steps in part.target_steps],
            extra=[row for part in parts for row in part.extra],
            seconds=sum(part.seconds for part in parts),
            curve={name: np.concatenate([part.curve[name] for part in parts], axis=1) for name in known},
            transformers=None if made[0] is None else together(made),
        )


@dataclass(frozen=True)
class Method:
    """One way to carry a policy to the target.

    Attributes:
      name: as on the command line and in tables.
      about: one line for `--help` and reports.
      work: what it does, for all seeds of a cell at once.
      kind: set of rollout policies, MS or ER.
      samples: what the metered budget of target steps is for: a log of the rollout policies, or steps of the agent
        itself; None where the method has no budget.
      grounding: how transformers are learned, `adversarial` being the paper's way; None learns none.
      several_policies: K of the preset, or one.
      ensemble: N of the preset, or one.
    """

    name: str
    about: str
    work: Callable[[Work], Trained]
    kind: str = "MS"
    samples: Literal["log", "agent"] | None = None
    grounding: Literal["adversarial", "vine", "inversion", "inversion+vine"] | None = None
    several_policies: bool = True
    ensemble: bool = False

    @property
    def uses_samples(self) -> bool:
        """Whether the method learns from target transitions of a metered budget."""
        return self.samples is not None
