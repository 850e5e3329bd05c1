"""Environments compiled once for the whole session."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
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
