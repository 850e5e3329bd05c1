"""Environments: one definition for each task, three physics engines behind it, targets as data.

>>> env = envs.make("BrokenCheetah")
>>> state = env.reset(jax.random.key(0))
>>> state = jax.jit(env.step)(state, jnp.zeros(env.action_size))
"""

from typing import TYPE_CHECKING

from envs.env import Env
from envs.registry import BACKENDS, DYNAMICS, build_model, engine_of, make, names, register, source_of
from envs.select import select
from envs.types import Engine, State, Task, Variant
from envs.wrappers import AutoReset, Environment, Wrapper

if TYPE_CHECKING:
    from envs.brax_bridge import BraxBridge
    from envs.gymnax_bridge import GymnaxBridge

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
    "Wrapper",
    "as_brax",
    "as_gymnax",
    "build_model",
    "engine_of",
    "make",
    "names",
    "register",
    "select",
    "source_of",
]


def as_brax(env: Environment) -> "BraxBridge":
    """`env` as a `brax.envs.Env`; for brax's `EpisodeWrapper`, `env.max_steps` is the time limit."""
    # Here, as brax takes seconds to import; after MJX, which brax imports too, to keep the note on Warp out of sight.
    import envs._mjx  # noqa: F401
    from envs.brax_bridge import BraxBridge

    return BraxBridge(env)


def as_gymnax(env: Environment) -> "GymnaxBridge":
    """`env` with gymnax's interface, for trainers such as rejax's and PureJaxRL's; gymnax is not needed."""
    from envs.gymnax_bridge import GymnaxBridge

    return GymnaxBridge(env)
