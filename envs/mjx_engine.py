"""MJX behind an environment: MuJoCo in JAX (`jax`, any accelerator) or in Warp (`warp`, NVIDIA only)."""

import jax
import mujoco
from mujoco import mjx


class MJXEngine:
    """`init` and `step` on MJX; batched by `vmap`.

    Args:
      model: compiled model.
      implementation: "jax" or "warp".
    """

    def __init__(self, model: mujoco.MjModel, implementation: str = "jax"):
        self.model = model
        self._implementation = implementation
        self._mjx_model = mjx.put_model(model, impl=implementation)

    def init(self, qpos: jax.Array, qvel: jax.Array) -> mjx.Data:
        """Physics state at `qpos [nq]`, `qvel [nv]`, time 0, without warm start."""
        return mjx.make_data(self.model, impl=self._implementation).replace(qpos=qpos, qvel=qvel)

    def step(self, data: mjx.Data, ctrl: jax.Array, count: int) -> mjx.Data:
        """`count` physics steps under `ctrl [nu]`."""
        data = data.replace(ctrl=ctrl)
        return jax.lax.fori_loop(0, count, lambda _, d: mjx.step(self._mjx_model, d), data)
