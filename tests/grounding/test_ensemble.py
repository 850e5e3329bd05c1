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

ROOT = Path(__file__).resolve().parents[2]
ground = partial(mpge_jax.ground_ensemble, points.SOURCE, config=points.CONFIG, quiet=True)


def flat(transformers) -> np.ndarray:
    """The parameters of each member, `[N, P]`."""
    leaves = [np.asarray(x) for x in jax.tree.leaves(transformers.params)]
    return np.concatenate([x.reshape(x.shape[0], -1) for x in leaves], axis=1)


def grounded(**options):
    """Four members: the first, and one each with another key, another log and other policies."""
    keys = jax.random.wrap_key_data(jnp.stack([jax.random.key_data(jax.random.key(i)) for i in (0, 1, 0, 0)]))
    logs = small.stacked(*(points.log(seed) for seed in (0, 0, 1, 0)))
    policies = small.stacked(*(points.policies(offset) for offset in (0.0, 0.0, 0.0, 0.2)))
    return ground(policies, logs, keys=keys, **options)


@pytest.fixture(scope="module")
def members():
    return grounded()


def test_a_key_a_log_and_policies_each_make_a_difference(members):
    params = flat(members[0])
    apart = np.abs(params[:, None] - params[None]).max(axis=-1)
    assert apart[~np.eye(4, dtype=bool)].min() > 1e-3


def test_a_member_is_the_run_alone(members):
    alone, _ = mpge_jax.ground(
        points.SOURCE, points.policies(0.2), points.log(), points.CONFIG, jax.random.key(0), quiet=True
    )
    found = flat(jax.tree.map(lambda x: x[None], alone))[0]
    np.testing.assert_allclose(found, flat(members[0])[3], rtol=2e-3, atol=2e-4)


SHARDED = """
import sys, numpy as np, jax
from mpge_jax import sharding
from tests.grounding.test_ensemble import flat, grounded
assert len(jax.devices()) == 4
found, curve = grounded(mesh=sharding.mesh(2, 2))
used = {d for x in jax.tree.leaves(found.params) for d in x.sharding.device_set}
assert len(used) == 4, used
np.savez(sys.argv[1], params=flat(found), reward=curve["reward"])
"""


def test_four_devices_give_the_result_of_one(members, tmp_path):
    file = tmp_path / "sharded.npz"
    done = subprocess.run(
        [sys.executable, "-c", SHARDED, str(file)],
        cwd=ROOT,
        env={
            **os.environ,
            "JAX_PLATFORMS": "cpu",
            "XLA_FLAGS": f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=4",
        },
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    transformers, curve = members
    with np.load(file) as sharded:
        np.testing.assert_allclose(flat(transformers), sharded["params"], atol=2e-3)
        np.testing.assert_allclose(curve["reward"], sharded["reward"], rtol=1e-3, atol=1e-3)


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
