"""Rows of several groups, each under the parameters of its own, without computing all rows under all of them."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, Shaped, UInt32

from mpge_jax.learning import lockstep


def take(rows: Shaped[Array, "B *row"], at: Int[Array, "*n"]) -> Shaped[Array, "..."]:
    """`rows[at]`, `[*n, *row]`, for `at` within: without the checks, which take longer than the rest."""
    return rows.at[at].get(mode="promise_in_bounds", wrap_negative_indices=False)


def argsort(keys: UInt32[Array, " B"], bits: int = 32) -> Int[Array, " B"]:
    """The stable order of `keys`, which are below `2**bits`.

    Several sorts of single numbers, part of the key before the place: on a CPU these take a fraction of one sort of
    keys with places beside them.
    """
    size = keys.shape[0]
    place_bits = max(1, (size - 1).bit_length())
    digit_bits = 32 - place_bits
    place = jnp.arange(size, dtype=jnp.uint32)
    order = jnp.arange(size)
    for low in range(0, bits, digit_bits):
        digit = take(keys, order) >> low & (2**digit_bits - 1)
        found = jnp.sort(digit << place_bits | place) & (2**place_bits - 1)
        order = take(order, found.astype(jnp.int32))
    return order


def apply(function: Callable[[Any, Any], Any], params: Any, rows: Any, group: Int[Array, " B"]) -> Any:
    """`function(params of the row's group, row)` of each of B rows, every leaf `[B, ...]`.

    All groups get as many places, the fewest of a few numbers that the largest group fits in.

    Args:
      function: of one row, pure.
      params: every leaf `[K, ...]`.
      rows: every leaf `[B, ...]`.
      group: of each row, from 0 to K - 1.
    """
    size, groups = group.shape[0], jax.tree.leaves(params)[0].shape[0]
    member = jax.nn.one_hot(group, groups, dtype=jnp.int32)
    count = jnp.sum(member, axis=0)
    first = jnp.cumsum(count) - count
    rank = jnp.sum(member * jnp.cumsum(member, axis=0), axis=1) - 1
    order = argsort(group.astype(jnp.uint32), groups.bit_length())

    def with_places(places: int) -> Callable[[], Any]:
        def applied() -> Any:
            row = take(order, jnp.minimum(first[:, None] + jnp.arange(places)[None], size - 1))
            placed = jax.tree.map(lambda x: take(x, row), rows)
            return jax.vmap(jax.vmap(function, (None, 0)))(params, placed)

        def back() -> Any:
            return jax.tree.map(lambda x: take(x.reshape(-1, *x.shape[2:]), group * places + rank), applied())

        return back

    # In eights, as processors compute in such.
    rooms = (-(-int(room * size / groups) // 8) * 8 for room in (1.25, 1.75, 2.5, groups))
    offered = sorted({min(size, room) for room in rooms})
    most = lockstep.largest(jnp.max(count))
    return jax.lax.switch(
        jnp.sum(most > jnp.array(offered[:-1], jnp.int32)), [with_places(n) for n in offered]
    )
