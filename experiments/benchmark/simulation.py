"""Environment steps: each backend, and one environment of Gymnasium."""

import importlib.util
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np

from mpge_jax import own_envs as own_envs  # isort: split

import envs
from envs.tasks import gymnasium_spec
from experiments.benchmark.clock import Row, measure, stepper

SOURCE = "HalfCheetah"


def available() -> tuple[str, ...]:
    """The physics backends that run on this machine."""
    nvidia = jax.default_backend() in ("gpu", "cuda") and importlib.util.find_spec("warp")
    return ("c", "mjx", "warp") if nvidia else ("c", "mjx")


def of_gymnasium(make: Callable[..., Any], *args: Any) -> Any:
    """Gymnasium's environment, or a vector of it, made by `make` with what follows its name."""
    with tempfile.TemporaryDirectory() as folder:
        # Without the deprecated attribute, of which MuJoCo would leave a log file in the working folder.
        model = Path(folder) / "model.xml"
        model.write_text(gymnasium_spec("half_cheetah.xml").to_xml())
        return make(f"{SOURCE}-v5", *args, xml_file=str(model))


def measure_gymnasium(seconds: float) -> Row:
    """One environment of Gymnasium in a Python loop: what the others are compared with."""
    env = of_gymnasium(gymnasium.make)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (500, *(env.action_space.shape or ())))

    def call() -> None:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    row = measure(call, len(actions), seconds)
    env.close()
    return {"backend": "gymnasium", "copies": 1, **row}


def measure_env(backend: str, copies: int, seconds: float) -> Row:
    """Steps a second of `copies` environments under uniform random actions, auto-reset included."""
    env = envs.AutoReset(envs.make(SOURCE, backend))
    steps = max(4, min(100, 4_096 // copies)) if backend == "c" else 8
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)

    def body(state: envs.State, key: jax.Array) -> tuple[envs.State, None]:
        action = jax.random.uniform(key, (copies, env.action_size), minval=low, maxval=high)
        return jax.vmap(env.step)(state, action), None

    @jax.jit
    def roll(carry: tuple[envs.State, jax.Array]) -> tuple[envs.State, jax.Array]:
        state, key = carry
        key, key_steps = jax.random.split(key)
        return jax.lax.scan(body, state, jax.random.split(key_steps, steps))[0], key

    first = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), copies))
    row = measure(stepper(roll, (first, jax.random.key(1))), copies * steps, seconds)
    return {"backend": backend, "copies": copies, **row}
