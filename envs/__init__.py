"""Environments: one definition for each task, three physics engines behind it, targets as data.

>>> env = envs.make("BrokenCheetah")
>>> state = env.reset(jax.random.key(0))
>>> state = jax.jit(env.step)(state, jnp.zeros(env.action_size))
"""

from envs.env import Env
from envs.registry import BACKENDS, DYNAMICS, build_model, make, names, register, source_of
from envs.types import Engine, State, Task, Variant
from envs.wrappers import AutoReset, Environment

__all__ = [
    "BACKENDS",
    "DYNAMICS",
    "AutoReset",
    "Engine",
    "Env",
    "Environment",
    "State",
    "Task",
    "Variant",
    "as_brax",
    "build_model",
    "make",
    "names",
    "register",
    "source_of",
]


def as_brax(env: Environment):  # noqa: ANN201  (brax is imported where it is used: it takes seconds)
    """`env` as a `brax.envs.Env`."""
    from envs.brax_bridge import BraxBridge

    return BraxBridge(env)
