"""Environments: one definition for each task, three physics engines behind it, targets as data.

>>> env = envs.make("BrokenCheetah")
>>> state = env.reset(jax.random.key(0))
>>> state = jax.jit(env.step)(state, jnp.zeros(env.action_size))
"""

from typing import TYPE_CHECKING

from envs.env import Env
from envs.registry import (
    BACKENDS,
    DYNAMICS,
    build_model,
    engine_of,
    home_of,
    make,
    names,
    plain_name,
    register,
    source_of,
)
from envs.select import finite_or, select
from envs.types import Engine, State, Task, Variant
from envs.wrappers import AutoReset, Environment, Wrapper

if TYPE_CHECKING:
    from envs.bridges.brax import BraxBridge
    from envs.bridges.gymnasium import GymnasiumBridge
    from envs.bridges.gymnasium_vector import GymnasiumVectorBridge
    from envs.bridges.gymnax import GymnaxBridge
    from envs.bridges.playground import PlaygroundBridge

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
    "as_gymnasium",
    "as_gymnasium_vector",
    "as_gymnax",
    "as_playground",
    "build_model",
    "engine_of",
    "finite_or",
    "home_of",
    "make",
    "names",
    "plain_name",
    "register",
    "select",
    "source_of",
]


def as_brax(env: Environment) -> "BraxBridge":
    """`env` as a `brax.envs.Env`; for brax's `EpisodeWrapper`, `env.max_steps` is the time limit."""
    # Here, as brax takes seconds to import; after MJX, which brax imports too, to keep the note on Warp out of sight.
    import envs._mjx  # noqa: F401
    from envs.bridges.brax import BraxBridge

    return BraxBridge(env)


def as_gymnax(env: Environment) -> "GymnaxBridge":
    """`env` with gymnax's interface, for trainers such as rejax's and PureJaxRL's; gymnax is not needed."""
    from envs.bridges.gymnax import GymnaxBridge

    return GymnaxBridge(env)


def as_gymnasium(env: Environment) -> "GymnasiumBridge":
    """`env` as a `gymnasium.Env`; its time limit is truncation. Nothing is registered: hand over the object."""
    from envs.bridges.gymnasium import GymnasiumBridge

    return GymnasiumBridge(env)


def as_gymnasium_vector(env: Environment, n: int, autoreset: str = "NextStep") -> "GymnasiumVectorBridge":
    """`n` copies of `env` as one `gymnasium.vector.VectorEnv`.

    `autoreset` is one of Gymnasium's modes: "NextStep", "SameStep" or "Disabled".
    """
    from envs.bridges.gymnasium_vector import GymnasiumVectorBridge

    return GymnasiumVectorBridge(env, n, autoreset)


def as_playground(env: Environment) -> "PlaygroundBridge":
    """`env` as a MuJoCo Playground `MjxEnv`, for its wrappers and trainers; on any backend.

    Raises:
      ImportError: MuJoCo Playground is not installed.
    """
    import envs._mjx  # noqa: F401

    try:
        import mujoco_playground  # noqa: F401
    except ModuleNotFoundError as error:
        if error.name != "mujoco_playground":
            raise
        raise ImportError(
            "as_playground needs MuJoCo Playground, which is not installed: pip install playground"
        ) from None
    from envs.bridges.playground import PlaygroundBridge

    return PlaygroundBridge(env)
