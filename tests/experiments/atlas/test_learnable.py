"""How much of what is left could be learnt: what is there is found, and what is not is not."""

import mujoco
import numpy as np
import pytest

from experiments.atlas import learnable

PENDULUM = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size=".1"/>
<body pos="0 0 1"><joint name="b" axis="0 1 0"/><geom size=".1"/></body></body></worldbody></mujoco>"""


def test_a_history_tells_how_long_and_how_far_since_each_joint_turned():
    time = np.array([0.0, 0.1, 0.2, 0.4, 0.5])
    v = np.array([[1.0, -2.0], [1.0, 2.0], [2.0, 2.0], [-1.0, 2.0], [-1.0, 0.0]])
    q = np.arange(10.0).reshape(5, 2)
    found = learnable.history(time, q, v)
    m = mujoco.MjModel.from_xml_string(PENDULUM)
    assert found.shape == (5, learnable.history_size(m))
    first = found[:, learnable.of_dof(m, 0)].T
    np.testing.assert_allclose(first[0], q[:, 0])
    np.testing.assert_allclose(first[1], v[:, 0])
    np.testing.assert_allclose(first[2], [1, 1, 1, -1, -1])
    np.testing.assert_allclose(first[3], [0.0, 0.1, 0.2, 0.0, 0.1], atol=1e-12)
    np.testing.assert_allclose(first[4], [0.0, 0.1, 0.3, 0.0, -0.1], atol=1e-12)
    np.testing.assert_allclose(first[5], time)
    np.testing.assert_allclose(found[:, learnable.of_dof(m, 1)[3]], [0.0, 0.0, 0.1, 0.3, 0.0], atol=1e-12)


def _missing(seed: int, rows: int) -> learnable.Missing:
    """The first force follows the first input, the second is noise, the third is unknown."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (rows, 3))
    force = np.column_stack([np.sin(4.0 * x[:, 0]), rng.normal(size=rows), np.full(rows, np.nan)])
    unsure = np.full((rows, 3), 0.1)
    # windows that tell nothing, and are wrong
    force[::10, 0], unsure[::10, 0] = 100.0, 10.0
    return learnable.Missing(x, force, unsure, [[0], [1], [2]])


def test_what_follows_an_input_is_learnt_and_noise_is_not():
    pytest.importorskip("sklearn")
    shares = learnable.left([_missing(0, 400), _missing(1, 200)], _missing(2, 300))
    assert shares[0] < 0.15
    assert 0.9 < shares[1] < 1.1
    assert shares[2] is None
