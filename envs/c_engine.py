"""MuJoCo's C engine inside JAX: many simulations of one model behind a callback."""

import atexit
import contextlib
import copy
import dataclasses
import functools
import os
import threading
from collections.abc import Callable, Sequence
from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import mujoco
import mujoco.batch
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

# MuJoCo's integration state without what the caller sets anew at every step (ctrl) or never (applied forces, mocap).
_CARRIED = ("qpos", "qvel", "act", "time", "qacc_warmstart", "history", "plugin_state", "plastic")

# After any of these MuJoCo has put the simulation back to the model's initial state.
_DIVERGED = [int(getattr(mujoco.mjtWarning, f"mjWARN_{name}")) for name in ("BADQPOS", "BADQVEL", "BADQACC")]

# One batch for each number of copies; each holds threads of its own.
_MOST_BATCHES = 8


@flax.struct.dataclass
class CData:
    """Physics state of one simulation; names and shapes as in `MjData`.

    Attributes:
      given: by name, what the caller sets: forces and fields of the model, see `CEngine`.
      seen: by name, what the engine computed on the way, see `CEngine`.
    """

    qpos: jax.Array
    qvel: jax.Array
    act: jax.Array
    time: jax.Array
    qacc_warmstart: jax.Array
    history: jax.Array
    plugin_state: jax.Array
    plastic: jax.Array
    sensordata: jax.Array
    given: dict[str, jax.Array] = flax.struct.field(default_factory=dict)
    seen: dict[str, jax.Array] = flax.struct.field(default_factory=dict)


class CEngine:
    """`init` and `step` on MuJoCo's C engine; batched by `vmap`, which becomes one call on all threads.

    A step is computed in float64; the state is carried in JAX's default float type, so that with `jax_enable_x64` a
    trajectory is MuJoCo's to the last bits. There are no derivatives. At its end a program waits for the steps under
    way whose results it still holds; JAX has no way to wait for others, which may take it down with a signal.

    A simulation that diverges, or whose state or control is not finite, becomes NaN, as in MJX. (MuJoCo itself would
    put it back to the model's initial state, or take the control for 0, and go on.)

    Args:
      model: compiled model.
      threads: threads of one batch; 0 takes all cores.
      forces: fields of `MjData` that the caller sets before a step, in `CData.given` (`qfrc_applied`, `xfrc_applied`).
      fields: fields of `MjModel` that each simulation has values of its own of, in `CData.given`; constants that
        MuJoCo derives from them are fields of their own.
      seen: fields of `MjData` that a step computes on its way, in `CData.seen`; one physics step behind, as after
        `mj_step`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        threads: int = 0,
        *,
        forces: Sequence[str] = (),
        fields: Sequence[str] = (),
        seen: Sequence[str] = (),
    ):
        self.model = _without_islands(model)
        self._forces, self._fields, self._seen = tuple(forces), tuple(fields), tuple(seen)
        self._threads = threads or cores()
        self._batches: dict[int, _Batch] = {}
        self._calls: dict[tuple[int, np.dtype[Any]], Callable[..., tuple[jax.Array, ...]]] = {}
        self._lock = threading.Lock()
        data = mujoco.MjData(model)
        named = (*_CARRIED, "sensordata", *self._forces, *self._seen)
        self._initial = {name: np.array(getattr(data, name)) for name in named}
        self._initial |= {name: np.array(getattr(model, name)) for name in self._fields}
        # MuJoCo keeps fields that the model does not have at size 0: nothing to carry across.
        self._carried = [name for name in _CARRIED if self._initial[name].size]
        self._given = [*self._forces, *self._fields]
        self._returned = self._carried + (["sensordata"] if model.nsensordata else []) + [*self._seen]

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy gets batches and a lock of its own: neither can be copied.
        make = functools.partial(CEngine, forces=self._forces, fields=self._fields, seen=self._seen)
        return make, (self.model, self._threads)

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
        given = {name: initial.pop(name) for name in self._given}
        seen = {name: initial.pop(name) for name in self._seen}
        return CData(**{**initial, "qpos": qpos, "qvel": qvel}, given=given, seen=seen)

    def forward(self, data: CData) -> CData:
        """What the engine computes on its way in the state of `data`, without moving it."""
        return self.step(data, jnp.zeros(self.model.nu, data.qpos.dtype), 0)

    def step(self, data: CData, ctrl: jax.Array, count: int) -> CData:
        """`count` physics steps under `ctrl [nu]`. `sensordata` is one physics step behind, as after `mj_step`."""
        _wait_at_exit()
        key = (count, np.dtype(data.qpos.dtype))
        if key not in self._calls:
            self._calls[key] = self._call(*key)
        carried = (getattr(data, name) for name in self._carried)
        values = self._calls[key](ctrl, *carried, *(data.given[name] for name in self._given))
        returned: dict[str, Any] = dict(zip(self._returned, values, strict=True))
        seen = {name: returned.pop(name) for name in self._seen}
        return dataclasses.replace(data, **returned, seen=seen)

    def _call(self, count: int, dtype: np.dtype[Any]) -> Callable[..., tuple[jax.Array, ...]]:
        """`(ctrl, *carried, *given) -> returned fields`; kept, as JAX would compile a new one at every step."""
        shapes = tuple(jax.ShapeDtypeStruct(self._initial[name].shape, dtype) for name in self._returned)

        def in_place(context: Any, results: Any, ctrl: Any, *fields: Any) -> None:
            del context
            self._step([np.asarray(x) for x in (ctrl, *fields)], [np.asarray(x) for x in results], count)

        def on_host(ctrl: Any, *fields: Any) -> tuple[np.ndarray, ...]:
            lead = np.shape(ctrl)[:-1]
            results = tuple(np.empty(lead + shape.shape, dtype) for shape in shapes)
            self._step([np.asarray(x) for x in (ctrl, *fields)], results, count)
            return results

        # `pure_callback` has the computation's own threads put its arguments on the device, and on CPU waits for ever
        # where they are all busy (jax issue 25861). A buffer callback reads and writes them where they are.
        on_cpu = buffer_callback(in_place, shapes, vmap_method="broadcast_all")
        elsewhere = functools.partial(jax.pure_callback, on_host, shapes, vmap_method="broadcast_all")
        return jax.jit(lambda *given: jax.lax.platform_dependent(*given, cpu=on_cpu, default=elsewhere))

    def _step(self, given: Sequence[np.ndarray], results: Sequence[np.ndarray], count: int) -> None:
        """Steps from `given` (ctrl, the carried fields and what the caller sets) into `results`, all `[*lead, ...]`."""
        size = int(np.prod(given[0].shape[:-1], dtype=np.int64))
        with self._lock:
            batch = self._batch(size)
            sound = np.ones(size, bool)
            for name, value in zip(["ctrl", *self._carried, *self._given], given, strict=True):
                view = batch.views[name]
                view[:] = value.reshape(view.shape)
                sound &= np.isfinite(view).reshape(size, -1).all(axis=1)
            # Stepped from a sound state and thrown away: MuJoCo would log each one.
            batch.native.state[~sound] = batch.rest
            before = batch.native.warning[:, _DIVERGED, 1].sum(axis=1)
            if count:
                batch.native.step(nstep=count)
            else:
                batch.native.forward()
            lost = ~sound | (batch.native.warning[:, _DIVERGED, 1].sum(axis=1) > before)
            for name, result in zip(self._returned, results, strict=True):
                view = batch.views[name]
                rows = result.reshape(view.shape)
                rows[:] = view
                rows[lost] = np.nan

    def _batch(self, size: int) -> "_Batch":
        # Least recently used first.
        batch = self._batches.pop(size, None) or _Batch(
            self.model,
            size,
            min(self._threads, size),
            ["ctrl", *self._returned, *self._forces],
            self._fields,
        )
        self._batches[size] = batch
        if len(self._batches) > _MOST_BATCHES:
            del self._batches[next(iter(self._batches))]
        return batch


class _Batch:
    """MuJoCo's batch of `size` simulations, with live views of its fields `[size, ...]`, those of the model too."""

    def __init__(
        self, model: mujoco.MjModel, size: int, threads: int, names: list[str], fields: Sequence[str]
    ):
        self.native = mujoco.batch.Batch(model, size, nthread=threads)
        self.native.reset()
        self.views = {name: self.native.bind(name) for name in names}
        self.views |= {name: self.native.expand(name) for name in fields}
        self.rest = self.native.state[0].copy()


def _without_islands(model: mujoco.MjModel) -> mujoco.MjModel:
    """`model`; a single tree without the search for parts that do not touch, which would find one."""
    if model.ntree > 1:
        return model
    model = copy.copy(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    return model


@functools.cache
def _wait_at_exit() -> None:
    """Has the interpreter, before it ends, wait for what is being computed."""
    # A thread that comes back from MuJoCo to an interpreter that has ended takes the process down.
    atexit.register(_wait)


def _wait() -> None:
    for array in jax.live_arrays():
        with contextlib.suppress(RuntimeError):
            array.block_until_ready()


def cores() -> int:
    # macOS has no affinity.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
