"""MJX behind an environment: MuJoCo in JAX, on any accelerator."""

import jax
import mujoco
import numpy as np

from envs._mjx import mjx, refused, without_lapack

# Model fields that MJX in JAX takes without a word and does not compute.
_IGNORED = (
    "actuator_delay",
    "actuator_dampingpoly",
    "dof_dampingpoly",
    "jnt_stiffnesspoly",
    "sensor_delay",
    "tendon_dampingpoly",
    "tendon_stiffnesspoly",
)


def check_computed(model: mujoco.MjModel) -> None:
    """Raises ValueError if the model uses what MJX in JAX takes without a word and leaves out."""
    ignored = [name for name in _IGNORED if np.any(getattr(model, name))]
    if ignored:
        raise ValueError(
            f"MJX does not compute {', '.join(ignored)}, which this model uses: take backend 'c'"
        )


class MJXEngine:
    """`init` and `step` on MJX; batched by `vmap`.

    Args:
      model: compiled model.

    Raises:
      ValueError: the model uses something that MJX does not compute.
    """

    def __init__(self, model: mujoco.MjModel):
        check_computed(model)
        self.model = model
        with refused():
            self._mjx_model = mjx.put_model(model, impl="jax")

    def init(self, qpos: jax.Array, qvel: jax.Array) -> mjx.Data:
        """Physics state at `qpos [nq]`, `qvel [nv]`, time 0, without warm start."""
        return mjx.make_data(self.model, impl="jax").replace(qpos=qpos, qvel=qvel)

    def step(self, data: mjx.Data, ctrl: jax.Array, count: int) -> mjx.Data:
        """`count` physics steps under `ctrl [nu]`."""
        data = data.replace(ctrl=ctrl)
        # MJX broadcasts across ranks, which a caller may have forbidden for their own code.
        with jax.numpy_rank_promotion("allow"):
            return jax.lax.fori_loop(0, count, lambda _, d: self._step(d), data)

    def _step(self, data: mjx.Data) -> mjx.Data:
        with without_lapack():
            return mjx.step(self._mjx_model, data)
