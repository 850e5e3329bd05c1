"""The Python loop around a compiled update: progress, learning curve, checkpoints, resumption.

A checkpoint holds the whole state and the curve so far, and is written atomically (orbax). An interrupted run that is
started again with the same arguments ends with the same bits as one that was never interrupted.
"""

import contextlib
import json
import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp

from mpge_jax.progress import ProgressBar

S = TypeVar("S")
Curve = dict[str, np.ndarray]


def run(
    update: Callable[[S], tuple[S, dict[str, jax.Array]]],
    state: S,
    iterations: int,
    *,
    title: str = "training",
    folder: Path | str | None = None,
    identity: Mapping[str, Any] | None = None,
    seconds_between_checkpoints: float = 60.0,
    note: Callable[[dict[str, np.ndarray]], str] = lambda metrics: "",
    stop: Callable[[dict[str, np.ndarray]], bool] | None = None,
    quiet: bool = False,
) -> tuple[S, Curve]:
    """Calls `update` `iterations` times, or until `stop` says so.

    The metrics of an iteration are fetched after the next one has been dispatched, so that a device computes while
    the host keeps the records.

    Args:
      update: one compiled iteration; may donate its argument.
      state: the state to start from, and the shape of every later one.
      iterations: number of calls in all, those of interrupted runs included. A finished run may be made longer.
      title: shown before the progress bar.
      folder: where checkpoints are kept; None keeps none.
      identity: what the run is (configuration, seed, data), JSON-serialisable; a checkpoint of another is refused.
      seconds_between_checkpoints: a checkpoint is written when so long has passed since the last, and at the end.
      note: text behind the progress bar, from the last metrics.
      stop: whether the run ends here, from the last metrics; the device then waits for the answer.
      quiet: show no progress.

    Returns:
      The final state and the curve: every metric, `[iterations done, ...]`.

    Raises:
      ValueError: `folder` holds a checkpoint of another run or of a longer one, or one that cannot be read.
      KeyboardInterrupt: Ctrl-C, once the iteration that it fell into is finished and saved.
    """
    rows: list[dict[str, np.ndarray]] = []
    store = None if folder is None else _Store(Path(folder), identity or {})
    if store is not None:
        state, rows = store.restore(state)
        if len(rows) > iterations:
            raise ValueError(
                f"The checkpoint in {folder} is {len(rows)} iterations long, beyond the {iterations} asked for; "
                "remove that folder to start anew, or choose another."
            )
    last = time.monotonic()
    waiting: dict[str, jax.Array] | None = None
    finished = len(rows) == iterations or bool(stop and rows and stop(rows[-1]))
    try:
        with ProgressBar(title, iterations, len(rows), quiet) as bar, _postponed_interrupt() as interrupted:

            def settle() -> None:
                nonlocal waiting
                if waiting is not None:
                    rows.append({name: np.asarray(value) for name, value in waiting.items()})
                    waiting = None
                    bar.advance(note(rows[-1]))

            while not finished:
                state, metrics = update(state)
                settle()
                waiting = metrics
                finished = len(rows) + 1 == iterations
                if stop is not None:
                    settle()
                    finished = finished or stop(rows[-1])
                due = store is not None and time.monotonic() - last >= seconds_between_checkpoints
                if due or finished or interrupted():
                    settle()
                    if store is not None:
                        store.save(state, rows)
                        last = time.monotonic()
                if interrupted():
                    raise KeyboardInterrupt
    finally:
        if store is not None:
            store.close()
    return state, _stack(rows)


@contextlib.contextmanager
def _postponed_interrupt() -> Iterator[Callable[[], bool]]:
    """Ctrl-C is noted, not raised; a second one is raised at once.

    In the middle of an iteration there is no state to save: the old one is donated, the new one is not there yet.
    """
    asked = threading.Event()

    def note(number: int, frame: Any) -> None:
        if asked.is_set():
            signal.default_int_handler(number, frame)
        asked.set()
        # Not print, which must not be entered from a signal handler.
        os.write(2, b"\nstopping after this iteration; Ctrl-C again stops at once\n")

    # Elsewhere Ctrl-C does not arrive, or its handling is somebody's own.
    ours = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if ours:
        signal.signal(signal.SIGINT, note)
    try:
        yield asked.is_set
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _stack(rows: list[dict[str, np.ndarray]]) -> Curve:
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]} if rows else {}


class _Store:
    """Checkpoints of one run in one folder."""

    def __init__(self, folder: Path, identity: Mapping[str, Any]):
        # orbax reports every save at level WARNING from threads of its own.
        logging.getLogger("absl").setLevel(logging.ERROR)
        self._folder = folder.absolute()
        self._identity = json.loads(json.dumps(identity, sort_keys=True, default=str))
        self._manager = ocp.CheckpointManager(
            self._folder,
            options=ocp.CheckpointManagerOptions(
                max_to_keep=2, enable_async_checkpointing=False, create=True
            ),
        )

    def restore(self, state: S) -> tuple[S, list[dict[str, np.ndarray]]]:
        step = self._manager.latest_step()
        if step is None:
            return state, []
        here = f"The checkpoint in {self._folder / str(step)}"
        remedy = "remove that folder to start anew, or choose another."
        leaves, structure = jax.tree.flatten(state)
        try:
            identity = self._manager.restore(
                step, args=ocp.args.Composite(identity=ocp.args.JsonRestore())
            ).identity
        except Exception as error:
            raise ValueError(f"{here} cannot be read ({type(error).__name__}); {remedy}") from error
        if identity != self._identity:
            names = sorted(
                k for k in {*identity, *self._identity} if identity.get(k) != self._identity.get(k)
            )
            raise ValueError(f"{here} is of another run: {', '.join(names)} differ; {remedy}")
        try:
            saved = self._manager.restore(
                step,
                args=ocp.args.Composite(state=ocp.args.StandardRestore(), curve=ocp.args.StandardRestore()),
            )
        except Exception as error:
            raise ValueError(f"{here} cannot be read ({type(error).__name__}); {remedy}") from error
        # Compared here: given the shapes, orbax would cut or pad what it reads.
        found = {name: np.asarray(value) for name, value in saved.state.items()}
        if _layout(found) != _layout(_named(leaves)):
            raise ValueError(f"{here} holds a state of other shapes than this run's; {remedy}")
        restored = [_like(found[str(i)], x) if str(i) in found else x for i, x in enumerate(leaves)]
        curve = {name: np.asarray(value) for name, value in saved.curve.items()}
        rows = [{name: values[i] for name, values in curve.items()} for i in range(step)]
        return jax.tree.unflatten(structure, restored), rows

    def save(self, state: Any, rows: list[dict[str, np.ndarray]]) -> None:
        if self._manager.latest_step() == len(rows):
            return
        self._manager.save(
            len(rows),
            args=ocp.args.Composite(
                state=ocp.args.StandardSave(_named(jax.tree.leaves(state))),
                curve=ocp.args.StandardSave(_stack(rows)),
                identity=ocp.args.JsonSave(self._identity),
            ),
        )

    def close(self) -> None:
        self._manager.close()


def _named(leaves: list[Any]) -> dict[str, np.ndarray]:
    """What orbax stores: leaves by number, without those of no elements (fields that a model does not have)."""
    return {str(i): _plain(leaf) for i, leaf in enumerate(leaves) if leaf.size}


def _layout(arrays: dict[str, np.ndarray]) -> dict[str, tuple[Any, ...]]:
    return {name: (array.shape, array.dtype) for name, array in arrays.items()}


def _is_key(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _plain(leaf: Any) -> np.ndarray:
    return np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)


def _like(saved: Any, leaf: Any) -> jax.Array:
    if _is_key(leaf):
        return jax.random.wrap_key_data(jnp.asarray(saved), impl=jax.random.key_impl(leaf))
    # Copied: an array that aliases the reader's memory cannot be donated.
    return jnp.array(saved, dtype=leaf.dtype, copy=True)
