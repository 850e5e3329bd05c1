"""A log in one line: order, ends of episodes, and padding."""

import jax.numpy as jnp
import numpy as np

from mpge_jax.rollouts.target_log import TargetLog
from mpge_jax.rollouts.trajectories import trajectories


def test_rows_are_in_order_and_episodes_end_where_they_end():
    log = TargetLog(
        observation=jnp.arange(8.0).reshape(2, 4, 1),
        action=jnp.zeros((2, 4, 1)),
        next_observation=jnp.arange(8.0).reshape(2, 4, 1) + jnp.array([1.0, 3.0, 1.0, 3.0])[None, :, None],
        terminated=jnp.zeros((2, 4)),
        episode=jnp.array([[0, 0, 1, 1], [0, 0, 0, 0]]),
        count=jnp.array([4, 2]),
    )
    rows = trajectories(log)
    assert int(rows.count) == 6
    np.testing.assert_array_equal(rows.observation[:6, 0], [0, 1, 2, 3, 4, 5])
    np.testing.assert_array_equal(rows.last[:6], [False, True, False, True, False, True])
    # Changes of 1 and 3 in equal parts.
    np.testing.assert_allclose(rows.scale, [1.0], rtol=1e-5)
