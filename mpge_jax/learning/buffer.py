"""A replay buffer that lives on the device: a ring of transitions with a fixed capacity.

Pure functions on a frozen pytree, so that a buffer can be scanned over, vmapped over seeds and donated.
Jit `add_batch` (or the step that calls it) with `donate_argnums` for the buffer: XLA then writes the new
rows in place instead of copying the whole ring.

Shapes: `N` new transitions, `B` batch size, `O` observation size, `A` action size.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int, PRNGKeyArray


class Transition(struct.PyTreeNode):
    """What SAC learns from. Leading axes are free: `[N]`, `[B]`, `[capacity]`.

    There is no `truncated` here on purpose: a time limit does not change the value of `next_obs`, so nothing
    that bootstraps may look at it. `next_obs` must be the true next observation, never the one after an
    auto-reset.
    """

    obs: Float[Array, "*n O"]
    action: Float[Array, "*n A"]  # in the environment's units
    reward: Float[Array, "*n"]
    next_obs: Float[Array, "*n O"]
    terminated: Float[Array, "*n"]  # 1.0 where the task itself ended, else 0.0


def check_shapes(transitions: Transition, obs_size: int, action_size: int) -> None:
    """Makes sure of one batch axis and the given sizes: a `[N, 1]` reward would broadcast to `[N, N]` errors.

    Raises:
      ValueError: a field has another shape.
    """
    count = transitions.obs.shape[0]
    expected = {
        "obs": (count, obs_size),
        "action": (count, action_size),
        "reward": (count,),
        "next_obs": (count, obs_size),
        "terminated": (count,),
    }
    for name, shape in expected.items():
        found = getattr(transitions, name).shape
        if found != shape:
            raise ValueError(f"{name} of the transitions must have shape {shape}, got {found}")


class ReplayBuffer(struct.PyTreeNode):
    """A ring of transitions.

    Attributes:
      rows: the transitions, packed side by side so that a batch is one gather, `[capacity, 2 O + A + 2]`.
      position: index of the row written next.
      size: number of valid rows.
      obs_size, action_size: `O` and `A` (static).
    """

    rows: Float[Array, "*n capacity F"]
    position: Int[Array, "*n"]
    size: Int[Array, "*n"]
    obs_size: int = struct.field(pytree_node=False)
    action_size: int = struct.field(pytree_node=False)

    @property
    def capacity(self) -> int:
        return self.rows.shape[-2]


def init(capacity: int, obs_size: int, action_size: int) -> ReplayBuffer:
    """An empty buffer for `capacity` transitions.

    Raises:
      ValueError: a size below 1.
    """
    for name, value in (("capacity", capacity), ("obs_size", obs_size), ("action_size", action_size)):
        if value < 1:
            raise ValueError(f"{name} of a replay buffer must be at least 1, got {value}")
    rows = jnp.zeros((capacity, 2 * obs_size + action_size + 2), jnp.float32)
    # Two arrays, not one twice: a buffer is donated, and one array cannot be donated for two.
    position, size = jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32)
    return ReplayBuffer(rows, position, size, obs_size, action_size)


def add_batch(buffer: ReplayBuffer, transitions: Transition) -> ReplayBuffer:
    """Writes `N` transitions over the oldest rows.

    Args:
      transitions: fields `[N, ...]`, `N` at most the capacity.

    Raises:
      ValueError: more transitions than rows, or shapes that do not fit the buffer.
    """
    check_shapes(transitions, buffer.obs_size, buffer.action_size)
    count = transitions.reward.shape[0]
    if count > buffer.capacity:
        raise ValueError(
            f"cannot add {count} transitions at once to a replay buffer of {buffer.capacity} rows"
        )
    new = jnp.concatenate(
        [
            transitions.obs,
            transitions.action,
            transitions.reward[:, None],
            transitions.next_obs,
            transitions.terminated[:, None],
        ],
        axis=-1,
        dtype=jnp.float32,
    )
    index = (buffer.position + jnp.arange(count)) % buffer.capacity
    return replace(
        buffer,
        rows=buffer.rows.at[index].set(new, unique_indices=True, mode="promise_in_bounds"),
        position=(buffer.position + count) % buffer.capacity,
        size=jnp.minimum(buffer.size + count, buffer.capacity),
    )


def sample(buffer: ReplayBuffer, key: PRNGKeyArray, batch_size: int) -> Transition:
    """`[B]` transitions drawn uniformly with replacement from the valid rows. `key` is consumed.

    The buffer must hold at least one transition: an empty one yields zeros.
    """
    index = jax.random.randint(key, (batch_size,), 0, buffer.size)
    rows = buffer.rows.at[index].get(mode="promise_in_bounds")
    o, a = buffer.obs_size, buffer.action_size
    return Transition(
        obs=rows[:, :o],
        action=rows[:, o : o + a],
        reward=rows[:, o + a],
        next_obs=rows[:, o + a + 1 : 2 * o + a + 1],
        terminated=rows[:, -1],
    )
