"""Transitions recorded in the target, and the only code that records them: every target step is counted.

Shapes: `K` rollout policies, `M` the largest number of transitions of one of them, `O` observation, `A` action size.
"""

from numbers import Integral
from pathlib import Path
from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, Shaped

from envs import AutoReset, Environment, State
from mpge_jax import files
from mpge_jax.rollouts.rollout import RolloutPolicies


class TargetLog(flax.struct.PyTreeNode):
    """Transitions `(s, a, s')` of K policies, at most M of each; rows beyond a policy's own count are padding.

    Units are the task's: SI for those that ship with the project, and its actuators' own for actions.
    `next_observation` of a row that ended an episode is the state truly reached, never the next episode's first.
    Several logs at once have a leading axis `n` more.

    Attributes:
      observation: s, `[K, M, O]`.
      action: a, what the policy asked for, `[K, M, A]`.
      next_observation: s', `[K, M, O]`.
      terminated: 1 where the task ended, `[K, M]`.
      episode: number of the episode that a row belongs to, from 0 for every policy, `[K, M]`.
      count: valid rows of each policy, `[K]`.
    """

    observation: Float[Array, "*n K M O"]
    action: Float[Array, "*n K M A"]
    next_observation: Float[Array, "*n K M O"]
    terminated: Float[Array, "*n K M"]
    episode: Int[Array, "*n K M"]
    count: Int[Array, "*n K"]

    @property
    def steps(self) -> int:
        """Target steps that this log took, over all policies."""
        return int(np.sum(np.asarray(self.count)))

    @property
    def valid(self) -> Bool[Array, "*n K M"]:
        """Which rows are no padding."""
        shape = jnp.shape(self.terminated)
        return jax.lax.broadcasted_iota(jnp.int32, shape, len(shape) - 1) < jnp.asarray(self.count)[..., None]

    def only(self, chosen: Bool[Array, "K M"]) -> "TargetLog":
        """The rows that are `chosen`, in their order; all leaves without a leading axis."""
        kept = chosen & self.valid
        order = jnp.argsort(~kept, axis=1, stable=True)

        def arranged(x: Shaped[Array, "K M *row"]) -> Shaped[Array, "K M *row"]:
            return jax.vmap(lambda rows, at: rows[at])(x, order)

        rows = {name: arranged(getattr(self, name)) for name in _ROW_FIELDS}
        return TargetLog(**rows, count=jnp.sum(kept, axis=1).astype(self.count.dtype))

    def rows(self) -> dict[str, Float[np.ndarray, "steps _"]]:
        """Observations, actions and next observations of all valid rows, policy by policy."""
        valid = np.asarray(self.valid)
        fields = ("observation", "action", "next_observation")
        return {name: np.asarray(getattr(self, name))[valid] for name in fields}


def collect(key: PRNGKeyArray, env: Environment, policies: RolloutPolicies, budget: int) -> TargetLog:
    """Takes exactly `budget` steps in the target `env`, shared evenly between the policies.

    Where the budget does not divide, the first policies take one step more. `key` is consumed.

    Raises:
      ValueError: the budget is no whole number or smaller than the number of policies, or these are policies of another
        task.
    """
    if not isinstance(budget, Integral):
        raise ValueError(f"a budget of target steps is a whole number, not {budget!r}")
    policies.check_fits(env)
    size = policies.size
    if budget < size:
        raise ValueError(
            f"a budget of {budget} target steps is smaller than the number of rollout policies, {size}"
        )
    each, rest = divmod(budget, size)
    wrapped = AutoReset(env)

    def step(
        state: State, episode: Int[Array, ""], params: Any, key: PRNGKeyArray
    ) -> tuple[State, Int[Array, ""], Any]:
        action = policies.act(params, state.obs, key)
        after = wrapped.step(state, action)
        row = (state.obs, action, after.info["next_obs"], after.info["terminated"], episode)
        return after, episode + (after.done > 0), row

    @jax.jit
    def record(key: PRNGKeyArray, params: Any) -> Any:
        key_reset, key_steps, key_rest = jax.random.split(key, 3)
        state = jax.vmap(wrapped.reset)(jax.random.split(key_reset, size))
        episode = jnp.zeros(size, jnp.int32)

        def body(carry: tuple[State, Int[Array, " K"]], key: PRNGKeyArray) -> Any:
            state, episode, row = jax.vmap(step)(*carry, params, jax.random.split(key, size))
            return (state, episode), row

        carry, rows = jax.lax.scan(body, (state, episode), jax.random.split(key_steps, each))
        rows = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), rows)
        if rest == 0:
            return rows
        first = jax.tree.map(lambda x: x[:rest], (*carry, params))
        *_, last = jax.vmap(step)(first[0], first[1], first[2], jax.random.split(key_rest, rest))

        def append(
            all_: Shaped[Array, "K each *row"], more: Shaped[Array, "rest *row"]
        ) -> Shaped[Array, "K each+1 *row"]:
            padded = jnp.zeros((size, 1, *more.shape[1:]), more.dtype).at[:rest, 0].set(more)
            return jnp.concatenate([all_, padded], axis=1)

        return jax.tree.map(append, rows, last)

    observation, action, next_observation, terminated, episode = record(key, policies.params)
    count = jnp.asarray([each + (k < rest) for k in range(size)], jnp.int32)
    return TargetLog(observation, action, next_observation, terminated, episode, count)


_ROW_FIELDS = ("observation", "action", "next_observation", "terminated", "episode")


def validate(log: TargetLog, env: Environment) -> None:
    """Checks that a log is what grounding `env` needs.

    Raises:
      ValueError: an empty log, shapes that do not fit `env`, or a value that is not finite; says where.
    """
    count = np.asarray(log.count)
    if count.ndim != 1 or np.ndim(log.observation) != 3:
        raise ValueError(
            "target log: count and observation need shapes [K] and [K, M, O], "
            f"got {count.shape} and {np.shape(log.observation)}"
        )
    policies, most = count.shape[0], log.observation.shape[1]
    wanted = {
        "observation": (policies, most, env.observation_size),
        "action": (policies, most, env.action_size),
        "next_observation": (policies, most, env.observation_size),
        "terminated": (policies, most),
        "episode": (policies, most),
    }
    for name, shape in wanted.items():
        found = np.shape(getattr(log, name))
        if found != shape:
            raise ValueError(f"target log: {name} has shape {found}, {env.name} needs {shape}")
    if policies == 0 or count.min() < 1:
        raise ValueError("target log: every rollout policy needs at least one transition, one has none")
    if count.max() > most:
        raise ValueError(f"target log: count says {count.max()} rows, but there are {most}")
    for name in ("observation", "action", "next_observation"):
        values = np.asarray(getattr(log, name))
        for k in range(policies):
            bad = ~np.isfinite(values[k, : count[k]]).all(axis=-1)
            if bad.any():
                raise ValueError(
                    f"target log: {name} of policy {k} is not finite in row {int(np.argmax(bad))}"
                )


def save(path: Path | str, log: TargetLog) -> None:
    """Writes the log as npz, atomically."""
    files.write_npz(path, {name: getattr(log, name) for name in (*_ROW_FIELDS, "count")})


def load(path: Path | str) -> TargetLog:
    """Reads what `save` wrote.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: the file is damaged or is not a target log.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"there is no target log at {path}")
    try:
        arrays = files.read_npz(path)
        fields = {name: jnp.asarray(arrays[name]) for name in (*_ROW_FIELDS, "count")}
    except Exception as error:
        raise ValueError(
            f"{path} is damaged or is not a target log ({type(error).__name__}: {error})"
        ) from error
    return TargetLog(**fields)
