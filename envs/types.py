"""The contract between tasks, variants, engines and environments."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import flax.struct
import jax
import mujoco

Observe = Callable[[Any], jax.Array]
Reward = Callable[[Any, jax.Array, Any, float], tuple[jax.Array, dict[str, jax.Array]]]


class State(flax.struct.PyTreeNode):
    """One environment between two steps; fields as in MuJoCo Playground and brax.

    Attributes:
      data: the engine's physics state. Every engine gives at least `qpos [nq]`, `qvel [nv]`, `time []`.
      obs: observation, `[O]`.
      reward: reward of the step that led here, `[]`.
      done: 1 where the episode ended here, `[]`.
      metrics: parts of the reward, scalars.
      info: `terminated`, `truncated` (0 or 1, apart), `steps` (of the episode so far), `next_obs` (the
        observation that the last step truly led to, also where a wrapper has reset `obs`), and where commands are late
        `command` (the last one, `[A]`).
    """

    data: Any
    obs: jax.Array
    reward: jax.Array
    done: jax.Array
    metrics: dict[str, jax.Array]
    info: dict[str, Any]


@dataclass(frozen=True)
class Task:
    """What is simulated and what is asked of it. All functions are pure and written for one environment.

    Attributes:
      name: unique name.
      spec: returns a fresh `MjSpec` at every call.
      frame_skip: physics steps in one environment step.
      reset: `key -> (qpos [nq], qvel [nv])`.
      observe: `data -> obs [O]`.
      reward: `(data before, action [A], data after, dt in s) -> (reward [], metrics)`.
      terminated: `data -> bool []`. A state that is not finite ends the episode whatever this says.
      to_state: `obs [O] -> (qpos [nq], qvel [nv])`, the inverse of `observe` up to coordinates that move nothing
        (a free root position is set to 0), and to what it cuts off (Hopper's velocities beyond 10); None where an
        observation does not determine the state.
      total_mass: scale all masses and inertias to this total in kg, or leave them (None).
      max_steps: time limit of an episode in environment steps.

    Raises:
      ValueError: `frame_skip` or `max_steps` below 1, or `total_mass` not above 0.
    """

    name: str
    spec: Callable[[], mujoco.MjSpec]
    frame_skip: int
    reset: Callable[[jax.Array], tuple[jax.Array, jax.Array]]
    observe: Observe
    reward: Reward
    terminated: Callable[[Any], jax.Array]
    to_state: Callable[[jax.Array], tuple[jax.Array, jax.Array]] | None = None
    total_mass: float | None = None
    max_steps: int = 1000

    def __post_init__(self) -> None:
        if self.frame_skip < 1 or self.max_steps < 1:
            raise ValueError(
                f"task {self.name}: frame_skip and max_steps must be at least 1, "
                f"got {self.frame_skip} and {self.max_steps}"
            )
        _check_mass(self.name, self.total_mass)


@dataclass(frozen=True)
class Variant:
    """A target: a task whose dynamics differ. Data, not a subclass.

    Attributes:
      name: unique name.
      task: name of the task that it changes.
      about: one sentence for lists and reports.
      spec: edits the `MjSpec` in place before it is compiled.
      action: `(action [A], low [A], high [A]) -> action [A]`, what the target executes in its place (clipped to the
        action box afterwards).
      total_mass: replaces the task's total mass, in kg.
      delay: physics steps after which a new command reaches the actuators; until then they hold the one before, 0 at
        the start of an episode. At most the task's `frame_skip`.

    Raises:
      ValueError: `total_mass` not above 0, or `delay` below 0.
    """

    name: str
    task: str
    about: str
    spec: Callable[[mujoco.MjSpec], None] | None = None
    action: Callable[[jax.Array, jax.Array, jax.Array], jax.Array] | None = None
    total_mass: float | None = None
    delay: int = 0

    def __post_init__(self) -> None:
        _check_mass(self.name, self.total_mass)
        if self.delay < 0:
            raise ValueError(f"{self.name}: delay must be at least 0 physics steps, got {self.delay}")


def _check_mass(name: str, total_mass: float | None) -> None:
    if total_mass is not None and not total_mass > 0:
        raise ValueError(f"{name}: total_mass must be above 0 kg, got {total_mass}")


class Engine(Protocol):
    """Physics behind an environment: two pure functions, jit- and vmap-able."""

    def init(self, qpos: jax.Array, qvel: jax.Array) -> Any:
        """Physics state at `qpos [nq]`, `qvel [nv]`, time 0, without warm start."""
        ...

    def step(self, data: Any, ctrl: jax.Array, count: int) -> Any:
        """`count` physics steps under `ctrl [nu]` held constant."""
        ...
