"""Names to environments."""

import difflib
import importlib.util
from collections.abc import Iterable
from pathlib import Path

import jax
import mujoco

from envs import own_tasks
from envs.c_engine import CEngine
from envs.env import Env
from envs.legacy import use_legacy_inertia
from envs.tasks import TASKS
from envs.types import Engine, Task, Variant
from envs.variants import VARIANTS, folded

BACKENDS = ("auto", "c", "mjx", "warp")
DYNAMICS = ("mujoco", "legacy")
ALIKE = 0.65
"""Likeness of two names (of `difflib`, 1 for equal ones) from which on one may be meant by the other."""

_tasks: dict[str, Task] = {task.name: task for task in TASKS}
_variants: dict[str, Variant] = {variant.name: variant for variant in VARIANTS}
# Where the file lies that an environment of a user's own was read from.
_homes: dict[str, Path] = {}


def names() -> list[str]:
    """Every name that `make` takes: tasks first, then variants."""
    return [*_tasks, *_variants]


def plain_name(name: str) -> str:
    """The name under which an environment is registered; `path/to/file.py:NAME` registers what that file defines.

    Raises:
      ValueError: the file does not exist, cannot be run, defines nothing, nothing of that name, or something of a name
        that is taken.
    """
    reference = own_tasks.split(name)
    if reference is None:
        return name
    path, plain = reference
    defined = own_tasks.defined_in(path)
    for item in defined:
        taken = _tasks.get(item.name) or _variants.get(item.name)
        if taken is None:
            register(item)
        elif taken is not item:
            raise ValueError(
                f"{path} defines {item.name!r}, the name of another environment; give it a new one"
            )
        _homes[item.name] = path.resolve().parent
    known = [item.name for item in defined]
    if plain not in known:
        what = f"does not define {plain!r}" if plain else "defines several things"
        raise ValueError(f"{path} {what}: write {path}:NAME with NAME one of {', '.join(known)}")
    return plain


def home_of(name: str) -> Path | None:
    """The folder of the file that defines the environment `name`; None for one that was not read from a file."""
    return _homes.get(name)


def source_of(name: str) -> str:
    """The task that the environment `name` is a variant of; `name` itself for a task."""
    name = plain_name(name)
    _check(name, names(), "environment")
    return _variants[name].task if name in _variants else name


def register(item: Task | Variant) -> None:
    """Adds a task or a variant of a registered task, for `make`.

    >>> envs.register(envs.Variant("WeakHopper", "Hopper", "half the torque", action=lambda a, low, high: a / 2))

    Raises:
      ValueError: the name is taken, or the variant's task is unknown.
    """
    if item.name in names():
        raise ValueError(f"an environment named {item.name!r} is registered already")
    if isinstance(item, Variant):
        _check(item.task, _tasks, "task")
        _variants[item.name] = item
    else:
        _tasks[item.name] = item


def build_model(task: Task, variant: Variant | None = None, dynamics: str = "mujoco") -> mujoco.MjModel:
    """Compiles a task's model with a variant's changes."""
    _check(dynamics, DYNAMICS, "dynamics")
    spec = task.spec()
    if variant is not None and variant.spec is not None:
        variant.spec(spec)
    if dynamics == "legacy":
        use_legacy_inertia(spec)
    model = spec.compile()
    total_mass = task.total_mass if variant is None or variant.total_mass is None else variant.total_mass
    if total_mass is not None:
        mujoco.mj_setTotalmass(model, total_mass)
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def make(name: str, backend: str = "auto", dynamics: str = "mujoco") -> Env:
    """An environment by name.

    Args:
      name: one of `names()`, or `path/to/file.py:NAME` for what a file of your own defines.
      backend: "c" (MuJoCo's C engine), "mjx" (MJX in JAX), "warp" (MJX-Warp, on NVIDIA GPUs where it is
        installed), or "auto": "c" on CPU, "warp" where it can be had, else "mjx".
      dynamics: "mujoco" as installed, or "legacy" with the capsule inertia of MuJoCo before 2.1.2.

    Raises:
      ValueError: a name that is not known (the nearest is offered), or a model that the backend cannot simulate.
    """
    name = plain_name(name)
    _check(name, names(), "environment")
    _check(backend, BACKENDS, "backend")
    variant = _variants.get(name)
    task = _tasks[source_of(name)]
    model = build_model(task, variant, dynamics)
    return Env(task, model, engine_of(model, backend), variant)


def engine_of(model: mujoco.MjModel, backend: str = "auto") -> Engine:
    """The physics of a compiled model on a backend, as in `make`.

    Raises:
      ValueError: a backend that is not known, or cannot simulate the model.
    """
    _check(backend, BACKENDS, "backend")
    if backend == "auto":
        backend = "c" if jax.default_backend() == "cpu" else "warp" if _has_warp() else "mjx"
    if backend == "c":
        return CEngine(model)
    if backend == "warp" and not _has_warp():
        raise ValueError(
            "backend 'warp' needs an NVIDIA GPU and Warp: pip install 'mpge-jax[cuda]', or take 'mjx'"
        )
    # MJX takes seconds to import and is not needed on CPU.
    if backend == "warp":
        from envs.warp_engine import WarpEngine

        return WarpEngine(model)
    from envs.mjx_engine import MJXEngine

    return MJXEngine(model)


def _has_warp() -> bool:
    try:
        jax.devices("cuda")
    except RuntimeError:
        return False
    return importlib.util.find_spec("warp") is not None


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that is most like another one; None where none is like it."""
    return next(iter(difflib.get_close_matches(name, list(known), n=1, cutoff=ALIKE)), None)


def _check(name: str, known: Iterable[str], kind: str) -> None:
    known = list(known)
    if name not in known:
        near = nearest(name, known)
        hint = "" if near is None else f"; did you mean {near!r}?"
        raise ValueError(f"unknown {kind} {name!r}{hint} (known: {folded(known)})")
