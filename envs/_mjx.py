"""MJX, imported without what it prints where the optional Warp is not installed, and kept from LAPACK on CPU."""

import contextlib
import io
import threading
import warnings
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.linalg

with contextlib.redirect_stdout(io.StringIO()) as _printed, warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from mujoco import mjx

for _line in _printed.getvalue().splitlines():
    if not _line.startswith(("Failed to import warp:", "Failed to import mujoco_warp:")):
        print(_line)

__all__ = ["mjx", "refused", "without_lapack"]

_swapping = threading.RLock()


@contextlib.contextmanager
def refused() -> Iterator[None]:
    """Says what MJX does not compute, and what does.

    Raises:
      ValueError: MJX cannot simulate the model that it is given in here.
    """
    try:
        yield
    except NotImplementedError as error:
        raise ValueError(f"MJX cannot simulate this model ({error}): take backend 'c'") from error


@contextlib.contextmanager
def without_lapack() -> Iterator[None]:
    """What MJX traces in here, in this thread, factors and solves without LAPACK when it runs on a CPU.

    Batched LAPACK calls of jaxlib wait for each other for ever where as many of them meet as JAX has CPU threads
    (docs/mjx-on-cpu.md). The choice is made when the code is lowered: other platforms get what MJX asked for.
    """
    linalg = jax.scipy.linalg
    here = threading.get_ident()
    with _swapping:
        cho_factor, cho_solve = linalg.cho_factor, linalg.cho_solve

        # What MJX does not ask for today, and what other threads ask for meanwhile, goes to JAX.
        def factor(a: Any, lower: bool = False, **options: Any) -> tuple[jax.Array, bool]:
            def theirs(a: jax.Array) -> jax.Array:
                return cho_factor(a, lower, **options)[0]

            if lower or a.ndim != 2 or threading.get_ident() != here:
                return theirs(a), lower
            return jax.lax.platform_dependent(a, cpu=_factor, default=theirs), lower

        def solve(c_and_lower: tuple[Any, bool], b: Any, **options: Any) -> jax.Array:
            def theirs(c: jax.Array, b: jax.Array) -> jax.Array:
                return cho_solve((c, lower), b, **options)

            c, lower = c_and_lower
            if lower or c.ndim != 2 or b.ndim != 1 or threading.get_ident() != here:
                return theirs(c, b)
            return jax.lax.platform_dependent(c, b, cpu=_solve, default=theirs)

        linalg.cho_factor, linalg.cho_solve = factor, solve  # type: ignore[assignment]
        try:
            yield
        finally:
            linalg.cho_factor, linalg.cho_solve = cho_factor, cho_solve


def _factor(a: jax.Array) -> jax.Array:
    """Upper `u [n, n]` with `u.T @ u = a [n, n]`; NaN where `a` is not positive definite, as LAPACK's in JAX."""
    size = a.shape[-1]
    columns = jnp.arange(size)

    # A loop and not n copies of its body, which cost seconds more to compile and are no faster in a step.
    def eliminate(i: jax.Array, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        rest, u = carry
        row = rest[i]
        pivot = jnp.where(row[i] > 0, row[i], jnp.nan)
        row = jnp.where(columns >= i, row / jnp.sqrt(pivot), 0.0)
        return rest - row[:, None] * row[None, :], u.at[i].set(row)

    u = jax.lax.fori_loop(0, size, eliminate, (a, jnp.zeros_like(a)))[1]
    return jnp.where(jnp.all(jnp.isfinite(jnp.diagonal(u))), u, jnp.nan)


def _solve(u: jax.Array, b: jax.Array) -> jax.Array:
    """`x [n]` with `u.T @ u @ x = b [n]`, for upper `u [n, n]`."""
    size = b.shape[-1]
    rows = jnp.arange(size)

    def forward(i: jax.Array, x: jax.Array) -> jax.Array:
        value = x[i] / u[i, i]
        return jnp.where(rows == i, value, x - jnp.where(rows > i, u[i], 0.0) * value)

    def backward(k: jax.Array, x: jax.Array) -> jax.Array:
        i = size - 1 - k
        value = x[i] / u[i, i]
        return jnp.where(rows == i, value, x - jnp.where(rows < i, u[:, i], 0.0) * value)

    return jax.lax.fori_loop(0, size, backward, jax.lax.fori_loop(0, size, forward, b))
