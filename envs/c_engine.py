"""MuJoCo's C engine inside JAX: many simulations of one model behind `jax.pure_callback`."""

import dataclasses
import os
import threading
import warnings
from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import mujoco
import mujoco.batch
import numpy as np


def _devices_exist() -> bool:
    # JAX lets the number of its CPU devices change until it has made them; there is no other public way to ask.
    number: int = jax.config.jax_num_cpu_devices  # type: ignore[attr-defined]
    try:
        jax.config.update("jax_num_cpu_devices", number + 2)
    except RuntimeError:
        return True
    jax.config.update("jax_num_cpu_devices", number)
    return False


# With asynchronous dispatch a callback can wait for ever for its own arguments: they are put on the device by the very
# threads that the computation around the callback keeps busy (jax issue 25861). The setting is read once: when the
# first computation makes JAX's CPU client.
_MAY_HANG = jax.config.read("jax_cpu_enable_async_dispatch") and _devices_exist()
jax.config.update("jax_cpu_enable_async_dispatch", False)

# MuJoCo's integration state without what the caller sets anew at every step (ctrl) or never (applied forces, mocap).
_CARRIED = ("qpos", "qvel", "act", "time", "qacc_warmstart", "history", "plugin_state", "plastic")

# After any of these MuJoCo has put the simulation back to the model's initial state.
_DIVERGED = [int(getattr(mujoco.mjtWarning, f"mjWARN_{name}")) for name in ("BADQPOS", "BADQVEL", "BADQACC")]

# One batch for each number of copies; each holds threads of its own.
_MOST_BATCHES = 8


@flax.struct.dataclass
class CData:
    """Physics state of one simulation; names and shapes as in `MjData`."""

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    time: jax.Array
    qacc_warmstart: jax.Array
    history: jax.Array
    plugin_state: jax.Array
    plastic: jax.Array
    sensordata: jax.Array


class CEngine:
    """`init` and `step` on MuJoCo's C engine; batched by `vmap`, which becomes one call on all threads.

    A step is computed in float64; the state is carried in JAX's default float type, so that with `jax_enable_x64` a
    trajectory is MuJoCo's to the last bits. There are no derivatives.

    A simulation that diverges, or whose state or control is not finite, becomes NaN, as in MJX. (MuJoCo itself would
    put it back to the model's initial state, or take the control for 0, and go on.)

    Args:
      model: compiled model.
      threads: threads of one batch; 0 takes all cores.

    Warns:
      RuntimeWarning: JAX computed before `envs` was imported, and calls may hang.
    """

    def __init__(self, model: mujoco.MjModel, threads: int = 0):
        if _MAY_HANG:
            warnings.warn(
                "JAX had computed before `envs` was imported, so its CPU client dispatches asynchronously and calls to "
                "MuJoCo's C engine may hang: import `envs` first, or set jax_cpu_enable_async_dispatch to False right "
                "after `import jax`",
                RuntimeWarning,
                stacklevel=4,  # the caller of `make`
            )
        self.model = model
        self._threads = threads or _cores()
        self._batches: dict[int, _Batch] = {}
        self._lock = threading.Lock()
        data = mujoco.MjData(model)
        self._initial = {name: np.array(getattr(data, name)) for name in (*_CARRIED, "sensordata")}
        # MuJoCo keeps fields that the model does not have at size 0: nothing to carry across.
        self._carried = [name for name in _CARRIED if self._initial[name].size]
        self._returned = self._carried + (["sensordata"] if model.nsensordata else [])

    def init(self, qpos: jax.Array, qvel: jax.Array) -> CData:
        """Physics state at `qpos [nq]`, `qvel [nv]`, time 0, without warm start (as after Gymnasium's reset).

        Raises:
          ValueError: the model has delayed actuators or sensors and JAX computes in float32, where the time stamps of
            their history are too coarse to find the right sample.
        """
        if self.model.nhistory and qpos.dtype != np.float64:
            raise ValueError(
                "the model has delayed actuators or sensors, whose history needs float64 time: call "
                'jax.config.update("jax_enable_x64", True) first'
            )
        initial = {name: jnp.asarray(value, qpos.dtype) for name, value in self._initial.items()}
        return CData(**{**initial, "qpos": qpos, "qvel": qvel})

    def step(self, data: CData, ctrl: jax.Array, count: int) -> CData:
        """`count` physics steps under `ctrl [nu]`. `sensordata` is one physics step behind, as after `mj_step`."""
        dtype = data.qpos.dtype
        shapes = [jax.ShapeDtypeStruct(self._initial[name].shape, dtype) for name in self._returned]

        def host(ctrl: Any, *fields: Any) -> list[np.ndarray]:
            return self._step(np.asarray(ctrl), [np.asarray(f) for f in fields], count, dtype)

        fields = (getattr(data, name) for name in self._carried)
        values = jax.pure_callback(host, shapes, ctrl, *fields, vmap_method="broadcast_all")
        return dataclasses.replace(data, **dict(zip(self._returned, values, strict=True)))

    def _step(self, ctrl: np.ndarray, fields: list[np.ndarray], count: int, dtype: Any) -> list[np.ndarray]:
        lead = ctrl.shape[:-1]
        size = int(np.prod(lead, dtype=np.int64))
        with self._lock:
            batch = self._batch(size)
            sound = np.ones(size, bool)
            for name, value in zip(["ctrl", *self._carried], [ctrl, *fields], strict=True):
                view = batch.views[name]
                view[:] = value.reshape(view.shape)
                sound &= np.isfinite(view).reshape(size, -1).all(axis=1)
            # Stepped from a sound state and thrown away: MuJoCo would log each one.
            batch.native.state[~sound] = batch.rest
            before = batch.native.warning[:, _DIVERGED, 1].sum(axis=1)
            batch.native.step(nstep=count)
            lost = ~sound | (batch.native.warning[:, _DIVERGED, 1].sum(axis=1) > before)
            results = [batch.views[name].astype(dtype) for name in self._returned]
        for result in results:
            result[lost] = np.nan
        return [
            result.reshape(lead + self._initial[name].shape)
            for name, result in zip(self._returned, results, strict=True)
        ]

    def _batch(self, size: int) -> "_Batch":
        # Least recently used first.
        batch = self._batches.pop(size, None) or _Batch(
            self.model, size, min(self._threads, size), ["ctrl", *self._returned]
        )
        self._batches[size] = batch
        if len(self._batches) > _MOST_BATCHES:
            del self._batches[next(iter(self._batches))]
        return batch


class _Batch:
    """MuJoCo's batch of `size` simulations, with live views of its fields `[size, ...]`."""

    def __init__(self, model: mujoco.MjModel, size: int, threads: int, names: list[str]):
        self.native = mujoco.batch.Batch(model, size, nthread=threads)
        self.native.reset()
        self.views = {name: self.native.bind(name) for name in names}
        self.rest = self.native.state[0].copy()


def _cores() -> int:
    # macOS has no affinity.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
