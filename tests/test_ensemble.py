"""Ensembles: members that differ in one thing alone differ, and devices make no difference."""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mpge_jax
from mpge_jax import sharding
from tests import points, small

ROOT = Path(__file__).resolve().parent.parent
ground = partial(mpge_jax.ground_ensemble, points.SOURCE, config=points.CONFIG, quiet=True)


def flat(transformers) -> np.ndarray:
    """The parameters of each member, `[N, P]`."""
    leaves = [np.asarray(x) for x in jax.tree.leaves(transformers.params)]
    return np.concatenate([x.reshape(x.shape[0], -1) for x in leaves], axis=1)


@pytest.fixture(scope="module")
def members():
    """Five members: one with another key, one with another log, one with other policies, and one with all three."""
    keys = jax.random.wrap_key_data(
        jnp.stack([jax.random.key_data(jax.random.key(i)) for i in (0, 1, 0, 0, 1)])
    )
    logs = small.stacked(*(points.log(seed) for seed in (0, 0, 1, 0, 1)))
    policies = small.stacked(*(points.policies(offset) for offset in (0.0, 0.0, 0.0, 0.2, 0.2)))
    return ground(policies, logs, keys=keys)[0]


def test_a_key_a_log_and_policies_each_make_a_difference(members):
    params = flat(members)
    apart = np.abs(params[:, None] - params[None]).max(axis=-1)
    assert apart[~np.eye(5, dtype=bool)].min() > 1e-3


def test_a_member_is_the_run_alone(members):
    alone, _ = mpge_jax.ground(
        points.SOURCE, points.policies(0.2), points.log(1), points.CONFIG, jax.random.key(1), quiet=True
    )
    found = flat(jax.tree.map(lambda x: x[None], alone))[0]
    np.testing.assert_allclose(found, flat(members)[4], rtol=2e-3, atol=2e-4)


SHARDED = """
import numpy as np, jax, jax.numpy as jnp, mpge_jax
from mpge_jax import sharding
from tests import points, small
from tests.test_ensemble import flat, ground
assert len(jax.devices()) == 4
keys = jax.random.split(jax.random.key(0), 4)
logs = small.stacked(*(points.log(seed) for seed in range(4)))
policies = small.stacked(*[points.policies()] * 4)
one, curve = ground(policies, logs, keys=keys)
many, other = ground(policies, logs, keys=keys, mesh=sharding.mesh(2, 2))
used = {d for x in jax.tree.leaves(many.params) for d in x.sharding.device_set}
assert len(used) == 4, used
np.testing.assert_allclose(flat(one), flat(many), atol=2e-3)
np.testing.assert_allclose(curve["reward"], other["reward"], rtol=1e-3, atol=1e-3)
"""


def test_four_devices_give_the_result_of_one():
    done = subprocess.run(
        [sys.executable, "-c", SHARDED],
        cwd=ROOT,
        env={
            **os.environ,
            "JAX_PLATFORMS": "cpu",
            "XLA_FLAGS": "--xla_force_host_platform_device_count=4 --xla_backend_optimization_level=0",
        },
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


def test_a_mesh_that_cannot_be_is_told():
    count = len(jax.devices())
    with pytest.raises(
        ValueError, match=f"a mesh of {count + 1} x 1 devices was asked for, there are {count}"
    ):
        sharding.mesh(members=count + 1)
    logs = small.stacked(points.log())
    with pytest.raises(ValueError, match="4 environments cannot be divided over 3 devices"):
        sharding.place(logs, _Mesh({"members": 1, "environments": 3}), 4)
    with pytest.raises(ValueError, match="1 members cannot be divided over 2 devices"):
        sharding.place(logs, _Mesh({"members": 2, "environments": 1}), 4)


class _Mesh:
    """Stands for a mesh of more devices than there are; refused before it is used."""

    def __init__(self, shape):
        self.shape = shape
