"""Picking between two states: which side wins, at which rank, and who keeps MJX's scratch space."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from tests.envs.compiled import COPIES, compiled


def tree(start):
    return {
        "scalar": start + jnp.arange(3.0),
        "matrix": (start + jnp.arange(12).reshape(3, 2, 2),),
        "key": jax.random.split(jax.random.key(start), 3),
        "none": None,
    }


@pytest.mark.parametrize("run", [envs.select, jax.jit(envs.select)])
def test_every_leaf_is_picked_copy_by_copy(run):
    new, old = tree(100), tree(0)
    picked = run(jnp.array([True, False, True]), new, old)
    np.testing.assert_array_equal(picked["scalar"], [100.0, 1.0, 102.0])
    np.testing.assert_array_equal(picked["matrix"][0][:, 0, 0], [100, 4, 108])
    np.testing.assert_array_equal(picked["matrix"][0][:, 1, 1], [103, 7, 111])
    assert picked["none"] is None
    for copy, side in enumerate((new, old, new)):
        np.testing.assert_array_equal(
            jax.random.key_data(picked["key"][copy]), jax.random.key_data(side["key"][copy])
        )


def test_the_mask_may_be_a_scalar_or_a_matrix():
    new, old = tree(100), tree(0)
    for mask, side in ((True, new), (False, old)):
        picked = envs.select(jnp.array(mask), new, old)
        np.testing.assert_array_equal(picked["matrix"][0], side["matrix"][0])
        np.testing.assert_array_equal(jax.random.key_data(picked["key"]), jax.random.key_data(side["key"]))
    mask = jnp.array([[True, False], [False, True], [False, False]])
    picked = envs.select(mask, new["matrix"], old["matrix"])[0]
    np.testing.assert_array_equal(picked, [[[100, 101], [2, 3]], [[4, 5], [106, 107]], [[8, 9], [10, 11]]])


def test_a_leaf_of_other_copies_is_refused():
    # A leaf of one copy would broadcast without a word.
    with pytest.raises(ValueError, match=r"leaves whose shape begins with the mask's, \(3,\); got \(1, 2\)"):
        envs.select(jnp.ones(3, bool), jnp.ones((1, 2)), jnp.zeros((3, 2)))


def test_mjx_keeps_its_scratch_space_wherever_it_lies():
    """The public fields are picked; `_impl` is the old state's."""
    reset = jax.vmap(compiled("InvertedPendulum", "mjx").env.reset)
    old = jax.jit(reset)(jax.random.split(jax.random.key(0), COPIES))
    scratch = jax.tree.map(jnp.ones_like, old.data._impl)
    new = old.replace(data=old.data.replace(qpos=old.data.qpos + 1.0, _impl=scratch), obs=old.obs + 1.0)
    assert jax.tree.leaves(scratch)
    mask = jnp.array([True, False, False, True])
    picked = jax.jit(envs.select)(mask, {"state": (new, 0 * mask)}, {"state": (old, 1 * mask)})["state"][0]
    jax.tree.map(np.testing.assert_array_equal, picked.data._impl, old.data._impl)
    np.testing.assert_array_equal(picked.data.qpos, old.data.qpos + mask[:, None])
    np.testing.assert_array_equal(picked.obs, old.obs + mask[:, None])
