"""Branching together: what decides how long a loop runs, alike for all members of the surrounding `vmap`s.

A loop or branch whose condition differs between members runs, under `vmap`, every arm for every member, and copies its
whole state after each turn to pick the members it is meant for. Where the body already leaves alone whom it does not
concern, one condition for all spares both.
"""

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap


@custom_vmap
def largest(x: jax.Array) -> jax.Array:
    """`x [*n]`; under `vmap` the largest of all members', and the same for each of them."""
    return x


@largest.def_vmap
def _(size: int, batched: list[bool], x: jax.Array) -> tuple[jax.Array, bool]:
    del size
    return largest(jnp.max(x, axis=0)) if batched[0] else largest(x), False
