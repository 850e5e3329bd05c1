"""Merged statistics against numpy on all the data at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mpge_jax.learning import normalise


def test_merged_batches_equal_numpy_on_all_rows():
    rng = np.random.default_rng(0)
    batches = [(rng.normal(3.0, 2.0, (n, 4)) + 100.0).astype(np.float32) for n in (1, 7, 300, 64)]
    stats = normalise.init(4)
    for batch in batches:
        stats = jax.jit(normalise.update)(stats, batch)
    rows = np.concatenate(batches).astype(np.float64)
    assert float(stats.count) == len(rows)
    np.testing.assert_allclose(stats.mean, rows.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(stats.variance, rows.var(axis=0), rtol=1e-3)


def test_merge_by_hand():
    # {1, 3} then {8}: mean 4, variance ((-3)^2 + (-1)^2 + 4^2) / 3 = 26 / 3
    stats = normalise.update(normalise.init(1), jnp.array([[1.0], [3.0]]))
    assert (float(stats.mean[0]), float(stats.variance[0])) == (2.0, 1.0)
    stats = normalise.update(stats, jnp.array([[8.0]]))
    assert float(stats.mean[0]) == pytest.approx(4.0)
    assert float(stats.variance[0]) == pytest.approx(26 / 3)


def test_many_small_batches_do_not_drift():
    rows = jax.random.normal(jax.random.key(0), (5_000, 8, 2)) * 0.5 + 10.0
    stats, _ = jax.lax.scan(lambda s, x: (normalise.update(s, x), None), normalise.init(2), rows)
    flat = np.asarray(rows, np.float64).reshape(-1, 2)
    np.testing.assert_allclose(stats.mean, flat.mean(axis=0), rtol=1e-4)
    np.testing.assert_allclose(stats.variance, flat.var(axis=0), rtol=1e-3)


def test_identity_before_any_data():
    x = jnp.array([[3.0, -2.0]])
    np.testing.assert_array_equal(normalise.normalise(normalise.init(2), x, floor=0.1), x)


def test_floor_holds_for_a_constant_feature():
    stats = normalise.update(normalise.init(2), jnp.array([[5.0, 0.0], [5.0, 4.0]]))
    np.testing.assert_allclose(normalise.scale(stats, 0.1), [0.1, 2.0], rtol=1e-6)
    # (5.05 - 5) / 0.1 = 0.5, (3 - 2) / 2 = 0.5
    np.testing.assert_allclose(normalise.normalise(stats, jnp.array([5.05, 3.0]), 0.1), [0.5, 0.5], atol=1e-5)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("shape", [(3, 3), (0, 2), (2,), (4, 3, 2)])
def test_wrong_shapes_are_refused(shape):
    with pytest.raises(ValueError, match=r"expected rows of shape \[B > 0, 2\]"):
        normalise.update(normalise.init(2), jnp.zeros(shape))
