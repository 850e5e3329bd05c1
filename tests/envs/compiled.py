"""Environments compiled once for the whole session."""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import envs
from envs.variants.odrl import ODRL

COPIES = 4
# ODRL's shifts are fields of models that are compared one by one: two stand for them where something is compiled.
NAMES = [
    *(name for name in envs.names() if name not in {variant.name for variant in ODRL}),
    *("hopper-gravity-2.0", "halfcheetah-morph-thigh-hard"),
]


class Compiled(NamedTuple):
    """An environment with its `reset` and `step` jitted over `COPIES` copies."""

    env: envs.Env
    reset: Callable
    step: Callable

    def start(self) -> envs.State:
        return self.reset(jax.random.split(jax.random.key(0), COPIES))

    def actions(self, seed: int = 0) -> jax.Array:
        """Uniform in the action box, `[COPIES, A]`."""
        shape = (COPIES, self.env.action_size)
        uniform = np.random.default_rng(seed).uniform(self.env.action_low, self.env.action_high, shape)
        return jnp.asarray(uniform, jnp.float32)


@cache
def compiled(name: str, backend: str = "c") -> Compiled:
    env = envs.make(name, backend)
    return Compiled(env, jax.jit(jax.vmap(env.reset)), jax.jit(jax.vmap(env.step)))


def assert_follows_mj_step(engine: Any, model: mujoco.MjModel, rtol: float, atol: float) -> None:
    """One joint and two actuators, 20 times three steps under random commands, against a loop over `mj_step`."""
    reference = mujoco.MjData(model)
    data = engine.init(jnp.zeros(1), jnp.zeros(1))
    step = jax.jit(lambda d, u: engine.step(d, u, 3))
    for control in np.random.default_rng(0).uniform(-1, 1, (20, 2)).astype(np.float32):
        data = step(data, jnp.asarray(control))
        reference.ctrl[:] = control
        mujoco.mj_step(model, reference, nstep=3)
    for name in ("qpos", "qvel", "act", "time", "sensordata"):
        np.testing.assert_allclose(
            getattr(data, name), getattr(reference, name), rtol=rtol, atol=atol, err_msg=name
        )
