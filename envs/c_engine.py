"""MuJoCo's C engine inside JAX: many simulations of one model behind `jax.pure_callback`."""

import os
import threading
from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import mujoco
import mujoco.batch
import numpy as np

# With asynchronous dispatch a callback can wait for ever for its own arguments: they are put on the device by the very
# threads that the computation around the callback keeps busy (jax issue 25861). Read when JAX's CPU client is made.
jax.config.update("jax_cpu_enable_async_dispatch", False)

# MuJoCo's integration state without what the caller sets anew at every step (ctrl, applied forces, mocap).
_CARRIED = ("qpos", "qvel", "act", "time", "qacc_warmstart", "history")


@flax.struct.dataclass
class CData:
    """Physics state of one simulation; names and shapes as in `MjData`."""

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    time: jax.Array
    qacc_warmstart: jax.Array
    history: jax.Array
    sensordata: jax.Array


class CEngine:
    """`init` and `step` on MuJoCo's C engine; batched by `vmap`, which becomes one call on all threads.

    A step is computed in float64; the state is carried in JAX's default float type, so that with `jax_enable_x64` a
    trajectory is MuJoCo's to the last bits.

    Args:
      model: compiled model.
      threads: threads of one batch; 0 takes all cores.
    """

    def __init__(self, model: mujoco.MjModel, threads: int = 0):
        self.model = model
        self._threads = threads or len(os.sched_getaffinity(0))
        self._batches: dict[int, tuple[mujoco.batch.Batch, dict[str, np.ndarray]]] = {}
        self._lock = threading.Lock()
        data = mujoco.MjData(model)
        self._sizes = {name: np.shape(getattr(data, name)) for name in (*_CARRIED, "sensordata")}
        self._initial = {name: np.array(getattr(data, name)) for name in ("act", "history")}

    def init(self, qpos: jax.Array, qvel: jax.Array) -> CData:
        """Physics state at `qpos [nq]`, `qvel [nv]`, time 0, without warm start (as after Gymnasium's reset)."""
        dtype = qpos.dtype
        return CData(
            qpos=qpos,
            qvel=qvel,
            act=jnp.asarray(self._initial["act"], dtype),
            time=jnp.zeros((), dtype),
            qacc_warmstart=jnp.zeros(self._sizes["qacc_warmstart"], dtype),
            history=jnp.asarray(self._initial["history"], dtype),
            sensordata=jnp.zeros(self._sizes["sensordata"], dtype),
        )

    def step(self, data: CData, ctrl: jax.Array, count: int) -> CData:
        """`count` physics steps under `ctrl [nu]`. `sensordata` is one physics step behind, as after `mj_step`."""
        dtype = data.qpos.dtype
        # MuJoCo keeps fields that the model does not have at size 0: nothing to carry across.
        carried = [name for name in _CARRIED if np.prod(self._sizes[name]) > 0]
        returned = carried + (["sensordata"] if self.model.nsensordata else [])
        shapes = [jax.ShapeDtypeStruct(self._sizes[name], dtype) for name in returned]

        def host(ctrl: Any, *fields: Any) -> list[np.ndarray]:
            return self._step(np.asarray(ctrl), [np.asarray(f) for f in fields], carried, returned, count, dtype)

        values = jax.pure_callback(
            host, shapes, ctrl, *(getattr(data, name) for name in carried), vmap_method="broadcast_all"
        )
        return data.replace(**dict(zip(returned, values, strict=True)))

    def _step(
        self,
        ctrl: np.ndarray,
        fields: list[np.ndarray],
        carried: list[str],
        returned: list[str],
        count: int,
        dtype: Any,
    ) -> list[np.ndarray]:
        lead = ctrl.shape[:-1]
        size = int(np.prod(lead, dtype=np.int64))
        with self._lock:
            batch, views = self._batch(size)
            views["ctrl"][:] = ctrl.reshape(size, -1)
            for name, value in zip(carried, fields, strict=True):
                views[name][:] = value.reshape(views[name].shape)
            batch.step(nstep=count)
            return [views[name].astype(dtype).reshape(lead + self._sizes[name]) for name in returned]

    def _batch(self, size: int) -> tuple[mujoco.batch.Batch, dict[str, np.ndarray]]:
        if size not in self._batches:
            batch = mujoco.batch.Batch(self.model, size, nthread=min(self._threads, size))
            batch.reset()
            names = ["ctrl", *(n for n in (*_CARRIED, "sensordata") if np.prod(self._sizes[n]) > 0)]
            self._batches[size] = batch, {name: batch.bind(name) for name in names}
        return self._batches[size]
