"""MJX-Warp behind an environment: MuJoCo on NVIDIA GPUs, thousands of copies in one call."""

import dataclasses
import functools

import flax.struct
import jax
import jax.numpy as jnp
import mujoco

from envs._mjx import mjx, refused

# Room for the contacts of all copies together, which Warp allocates before it knows how many they are: as many as
# these copies can have at their very most, which is far more than so many have at once.
_COPIES = 16_384

# What a step can run out of room for and then leaves out: bits of MuJoCo Warp's OverflowType (constraints, their
# Jacobian, pairs, contacts, convex pairs, height fields). Its other bits tell of iterations that were used up.
_LEFT_OUT = 0b111111

# State that MuJoCo's C engine carries from step to step and this one does not.
_NOT_CARRIED = ("history", "plugin_state", "plastic")


@flax.struct.dataclass
class WarpData:
    """Physics state of one simulation; names and shapes as in `MjData`.

    Plain arrays, each with the copies in front: in `mjx.Data` some are shared by all copies with Warp, and neither
    `jnp.where` over two states nor a broadcast of one means then what it says.
    """

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    time: jax.Array
    qacc_warmstart: jax.Array
    sensordata: jax.Array


_NAMES = tuple(field.name for field in dataclasses.fields(WarpData))


class WarpEngine:
    """`init` and `step` on MJX-Warp; batched by `vmap`, nested too.

    A simulation that diverges, or that had contacts for which there was no room, becomes NaN.

    Args:
      model: compiled model.
      copies: contacts have room as for so many copies with the most contacts that the model can have.

    Raises:
      ValueError: MJX cannot simulate the model.
    """

    def __init__(self, model: mujoco.MjModel, copies: int = _COPIES):
        self.model = model
        self._initial = mujoco.MjData(model)
        carried = [name for name in _NOT_CARRIED if getattr(self._initial, name).size]
        if carried:
            raise ValueError(
                f"MJX-Warp does not carry {', '.join(carried)}, which this model has: take backend 'c'"
            )
        with refused():
            self._mjx_model = mjx.put_model(model, impl="warp")
            most = mjx.make_data(model, impl="jax")._impl
        sizes = {"naconmax": max(1, most.ncon) * copies, "njmax": max(1, most.nefc)}
        self._make = functools.partial(mjx.make_data, model, impl="warp", **sizes)

    def init(self, qpos: jax.Array, qvel: jax.Array) -> WarpData:
        """Physics state at `qpos [nq]`, `qvel [nv]`, time 0, without warm start."""
        values = {name: jnp.asarray(getattr(self._initial, name), qpos.dtype) for name in _NAMES}
        return WarpData(**{**values, "qpos": qpos, "qvel": qvel})

    def step(self, data: WarpData, ctrl: jax.Array, count: int) -> WarpData:
        """`count` physics steps under `ctrl [nu]`. `sensordata` is one physics step behind, as after `mj_step`."""
        begun = self._make().replace(ctrl=ctrl, **{name: getattr(data, name) for name in _NAMES})
        # MJX broadcasts across ranks, which a caller may have forbidden for their own code.
        with jax.numpy_rank_promotion("allow"):
            ended = jax.lax.fori_loop(0, count, lambda _, d: mjx.step(self._mjx_model, d), begun)
        lost = jnp.any(ended._impl.overflow & _LEFT_OUT)
        return WarpData(**{name: jnp.where(lost, jnp.nan, getattr(ended, name)) for name in _NAMES})
