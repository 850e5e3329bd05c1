"""The replay buffer against a list, and what XLA does with a donated one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mpge_jax.learning import buffer as replay
from mpge_jax.learning.buffer import Transition

OBS, ACTION = 3, 2
add = jax.jit(replay.add_batch)


def transitions(start: int, count: int) -> Transition:
    """Transitions `start, start + 1, ...`; every field of number i tells i."""
    number = np.arange(start, start + count, dtype=np.float32)
    return Transition(
        obs=np.tile(number[:, None], (1, OBS)),
        action=np.tile(number[:, None] + 0.25, (1, ACTION)),
        reward=number + 0.5,
        next_obs=np.tile(number[:, None] + 1.0, (1, OBS)),
        terminated=number % 2,
    )


def assert_consistent(batch: Transition) -> np.ndarray:
    """All fields of each row belong to one transition; returns the transitions' numbers."""
    number = np.asarray(batch.obs[:, 0])
    expected = jax.tree.map(lambda *rows: np.concatenate(rows), *[transitions(int(i), 1) for i in number])
    jax.tree.map(np.testing.assert_array_equal, batch, expected)
    return number.astype(int)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(1, 5), min_size=1, max_size=8))
def test_holds_the_last_transitions_in_a_ring(counts):
    capacity = 5
    buffer, ring, start = replay.init(capacity, OBS, ACTION), {}, 0
    for count in counts:
        buffer = add(buffer, transitions(start, count))
        ring.update({i % capacity: i for i in range(start, start + count)})
        start += count
    assert int(buffer.size) == min(start, capacity)
    assert int(buffer.position) == start % capacity
    for row, number in ring.items():
        assert float(buffer.rows[row, 0]) == number


def test_samples_are_whole_transitions_from_the_valid_rows_only():
    buffer = add(replay.init(100, OBS, ACTION), transitions(10, 4))
    numbers = assert_consistent(replay.sample(buffer, jax.random.key(0), 64))
    assert set(numbers) == {10, 11, 12, 13}


def test_samples_are_uniform_after_the_wrap():
    buffer = replay.init(4, OBS, ACTION)
    for start in (0, 3):
        buffer = add(buffer, transitions(start, 3))
    batch = replay.sample(buffer, jax.random.key(0), 4000)
    numbers, counts = np.unique(np.asarray(batch.obs[:, 0]), return_counts=True)
    assert list(numbers) == [2, 3, 4, 5]
    # 1,000 expected of each, standard deviation 27.
    assert np.all(np.abs(counts - 1000) < 140)


def test_same_key_same_batch():
    buffer = add(replay.init(100, OBS, ACTION), transitions(0, 50))
    draw = lambda seed: np.asarray(replay.sample(buffer, jax.random.key(seed), 8).reward)  # noqa: E731
    np.testing.assert_array_equal(draw(0), draw(0))
    assert not np.array_equal(draw(0), draw(1))


def test_vmaps_over_seeds():
    buffers = jax.vmap(lambda _: replay.init(4, OBS, ACTION))(jnp.arange(2))
    batch = jax.tree.map(lambda *x: jnp.stack(x), transitions(0, 3), transitions(100, 3))
    buffers = jax.vmap(replay.add_batch)(buffers, batch)
    sampled = jax.vmap(lambda b, k: replay.sample(b, k, 16))(buffers, jax.random.split(jax.random.key(0)))
    assert buffers.capacity == 4
    assert set(np.asarray(sampled.obs[0, :, 0])) <= {0, 1, 2}
    assert set(np.asarray(sampled.obs[1, :, 0])) <= {100, 101, 102}


@pytest.mark.parametrize("seeds", [None, 2])
def test_a_donated_buffer_is_written_in_place(seeds):
    add, batch = replay.add_batch, transitions(0, 3)
    buffer = replay.init(1000, OBS, ACTION)
    if seeds:
        add = jax.vmap(add)
        buffer, batch = jax.tree.map(lambda x: jnp.stack([x] * seeds), (buffer, batch))
    before = buffer.rows
    compiled = jax.jit(add, donate_argnums=0).lower(buffer, batch).compile()
    after = compiled(buffer, batch)
    assert before.is_deleted()
    # The compiled program needs less scratch memory than one copy of the ring.
    assert compiled.memory_analysis().temp_size_in_bytes < after.rows.nbytes / 2


@pytest.mark.parametrize("size", ["capacity", "obs_size", "action_size"])
def test_refuses_sizes_below_one(size):
    sizes = {"capacity": 4, "obs_size": OBS, "action_size": ACTION, size: 0}
    with pytest.raises(ValueError, match=f"{size} of a replay buffer must be at least 1, got 0"):
        replay.init(**sizes)


def test_refuses_more_transitions_than_rows():
    with pytest.raises(ValueError, match="cannot add 5 transitions at once to a replay buffer of 4 rows"):
        replay.add_batch(replay.init(4, OBS, ACTION), transitions(0, 5))


def test_refuses_a_reward_column():
    batch = transitions(0, 3)
    with pytest.raises(ValueError, match=r"reward of the transitions must have shape \(3,\), got \(3, 1\)"):
        replay.add_batch(replay.init(4, OBS, ACTION), batch.replace(reward=batch.reward[:, None]))
