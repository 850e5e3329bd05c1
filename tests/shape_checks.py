"""Shapes and types checked at every call: what `conftest.py` puts around the functions of `MODULES`.

Functions only. Fields of states are not checked where a state is made: JAX makes states through `__init__` wherever it
unflattens one, out of None, axis numbers, `ShapeDtypeStruct` or `object()`. `tests/test_shapes.py` checks the fields of
real ones. Nor are those of configurations: they check themselves, and say so in words of their own.
"""

from collections.abc import Callable
from typing import Any

from beartype import BeartypeConf, FrozenDict, beartype

from envs import Env, Environment
from tests.probes import Probe

MODULES = tuple(
    f"mpge_jax.{name}"
    for name in (
        "grounding.adversarial",
        "grounding.collect",
        "grounding.discriminator",
        "grounding.early_stop",
        "grounding.inversion",
        "grounding.prediction",
        "grounding.transform_error",
        "grounding.transformer",
        "learning.agent",
        "learning.buffer",
        "learning.distributions",
        "learning.normalise",
        "learning.policy_gradient",
        "learning.ppo",
        "learning.sac",
        "learning.trpo",
        "learning.value",
        "rollouts.policies",
        "rollouts.rollout",
        "rollouts.target_log",
    )
)

_CONF = BeartypeConf(
    # An int will do for a float, as for mypy.
    is_pep484_tower=True,
    # A probe has the interface of `Env`, though not its class. `Environment` is an interface alone, which anything may
    # have, and which cannot be asked for at run time.
    hint_overrides=FrozenDict({Env: Env | Probe, Environment: object}),
)


def check(function: Callable[..., Any]) -> Callable[..., Any]:
    """The typechecker of jaxtyping's import hook."""
    return function if function.__name__ == "__init__" else beartype(conf=_CONF)(function)
