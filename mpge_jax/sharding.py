"""Spreading the members of an ensemble, and their environments, over devices.

A mesh has two axes, `members` and `environments`: the N members are divided over the first, the B simulators of each
member over the second. Networks are copied to all devices of a member. The result is that of one device up to the
order of sums, which spreading environments changes and spreading members does not.

>>> mesh = sharding.mesh(members=5)  # five devices, one member each
>>> transformers, curve = ground_ensemble(..., mesh=mesh)

Meant for MJX: the callback into MuJoCo's C engine runs on the host, and uses all its cores without any mesh.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

AXES = ("members", "environments")


def mesh(members: int = 1, environments: int = 1) -> Mesh:
    """A mesh of the first `members * environments` devices.

    Raises:
      ValueError: there are not so many.
    """
    devices = jax.devices()
    if members < 1 or environments < 1 or members * environments > len(devices):
        raise ValueError(
            f"a mesh of {members} x {environments} devices was asked for, there are {len(devices)}: {devices}"
        )
    return Mesh(np.array(devices[: members * environments]).reshape(members, environments), AXES)


def place(tree: Any, over: Mesh, num_envs: int) -> Any:
    """Puts arrays `[N, ...]` on the devices of a mesh; the physics states `[N, num_envs, ...]` by environment too.

    Raises:
      ValueError: N or `num_envs` cannot be divided evenly over its axis.
    """
    return jax.device_put(tree, _shardings(tree, over, num_envs))


def compile(update: Callable[..., Any], state: Any, over: Mesh | None) -> Callable[..., Any]:
    """`update(state, *data) -> (state, metrics)` compiled, its state donated, and kept where `place` put it."""
    if over is None:
        return jax.jit(update, donate_argnums=0)
    placed = jax.tree.map(lambda x: x.sharding, state)
    return jax.jit(update, donate_argnums=0, out_shardings=(placed, None))


def _shardings(tree: Any, over: Mesh, num_envs: int) -> Any:
    members, environments = (over.shape[axis] for axis in AXES)
    if num_envs % environments:
        raise ValueError(f"{num_envs} environments cannot be divided over {environments} devices")

    def of(path: tuple[Any, ...], leaf: Any) -> NamedSharding:
        if leaf.shape[0] % members:
            raise ValueError(f"{leaf.shape[0]} members cannot be divided over {members} devices")
        names = {getattr(entry, "name", None) for entry in path}
        by_environment = bool(names & {"env_state", "rollout_policy"})
        return NamedSharding(over, PartitionSpec(*AXES) if by_environment else PartitionSpec(AXES[0]))

    return jax.tree_util.tree_map_with_path(of, tree)
