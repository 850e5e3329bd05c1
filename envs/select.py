"""Picking between two states, or rows, copy by copy."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp


def select(mask: jax.Array, new: Any, old: Any) -> Any:
    """`new` where `mask [*L]` is true, else `old`: two pytrees of one structure, whose leaves are all `[*L, ...]`.

    MJX's scratch space, `Data._impl`, is always `old`'s: every step computes it anew, and Warp's is shared by all
    copies.

    Raises:
      ValueError: a leaf whose shape does not begin with the mask's.
    """

    def pick(new: Any, old: Any) -> Any:
        if _is_mjx_data(new):
            public = select(mask, new.replace(_impl=None), old.replace(_impl=None))
            return public.replace(_impl=old._impl)
        for leaf in (new, old):
            if jnp.shape(leaf)[: mask.ndim] != mask.shape:
                raise ValueError(
                    f"select wants leaves whose shape begins with the mask's, {mask.shape}; got {jnp.shape(leaf)}"
                )
        return jnp.where(mask.reshape(mask.shape + (1,) * (jnp.ndim(new) - mask.ndim)), new, old)

    return jax.tree.map(pick, new, old, is_leaf=_is_mjx_data)


def finite_or(new: jax.Array, old: jax.Array) -> jax.Array:
    """Rows of `new [*L, O]` whose numbers are all finite; `old`'s of the others, as a simulation that diverged led
    nowhere, and one row that is not finite spoils whatever learns from it."""
    return jnp.where(jnp.isfinite(new).all(axis=-1, keepdims=True), new, old)


def _is_mjx_data(node: Any) -> bool:
    # By its looks, as MJX takes seconds to import. Key arrays have an `_impl` too, and are no dataclasses.
    return dataclasses.is_dataclass(node) and getattr(node, "_impl", None) is not None
