"""Rows under the parameters of their own group, and conditions that members share."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.learning import grouped, lockstep


@pytest.mark.parametrize("bits", [3, 32])
@pytest.mark.parametrize("size", [1, 2, 7, 2048, 70_000])
def test_argsort_is_a_stable_sort(size, bits):
    drawn = np.random.default_rng(size).integers(0, 2**bits, size, dtype=np.uint32)
    # Many alike: their order is that of their places.
    keys = np.where(np.arange(size) % 3 == 0, drawn, drawn[0])
    order = jax.jit(grouped.argsort, static_argnums=1)(jnp.asarray(keys), bits)
    np.testing.assert_array_equal(order, np.argsort(keys, kind="stable"))


def shares(kind: str) -> jax.Array:
    every = {
        "even": jnp.arange(64) % 5,
        "drawn": jax.random.randint(jax.random.key(3), (64,), 0, 5),
        "one has nearly all": jnp.where(jnp.arange(64) == 9, 0, 4),
        "one has all": jnp.full(64, 2),
    }
    return every[kind]


@pytest.mark.parametrize("kind", ["even", "drawn", "one has nearly all", "one has all"])
def test_every_row_has_the_answer_of_its_own_group(kind):
    weights, x = jnp.arange(1.0, 6.0), jnp.arange(64.0)
    group = shares(kind)
    found = jax.jit(lambda g: grouped.apply(lambda w, row: w * row[0] + row[1], weights, (x, -x), g))(group)
    np.testing.assert_allclose(found, (group + 1.0) * x - x)


def test_members_whose_groups_differ_in_size_do_not_disturb_each_other():
    weights, x = jnp.arange(1.0, 6.0), jnp.arange(64.0)
    groups = jnp.stack([shares("even"), shares("one has all")])
    found = jax.vmap(lambda g: grouped.apply(lambda w, row: w * row, weights, x, g))(groups)
    np.testing.assert_allclose(found, (groups + 1.0) * x[None])


def test_the_largest_is_of_all_members_through_nested_maps():
    numbers = jnp.array([[1, 7, 2], [3, 0, 4]])
    np.testing.assert_array_equal(jax.vmap(jax.vmap(lockstep.largest))(numbers), jnp.full((2, 3), 7))
    assert int(lockstep.largest(jnp.int32(3))) == 3
    # A loop that stops by it turns as often for all: the condition is one number.
    turns = jax.vmap(
        lambda n: jax.lax.while_loop(lambda i: i < lockstep.largest(n), lambda i: i + 1, jnp.int32(0))
    )
    np.testing.assert_array_equal(turns(jnp.array([2, 5])), [5, 5])
