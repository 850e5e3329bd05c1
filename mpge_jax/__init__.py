"""MPGE in JAX: grounding a simulator in a target's dynamics, policies that carry over, and what the simulator lacks."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mpge_jax.diagnosis import diagnose
    from mpge_jax.grounding.config import GroundingConfig
    from mpge_jax.grounding.ensemble import ground, ground_ensemble, invert_ensemble
    from mpge_jax.grounding.grounded_env import GroundedEnv
    from mpge_jax.grounding.inversion import InversionConfig
    from mpge_jax.rollouts.policies import PolicySet
    from mpge_jax.rollouts.rollout import RolloutPolicies
    from mpge_jax.rollouts.target_log import TargetLog

_HOME = {
    "GroundedEnv": "grounding.grounded_env",
    "GroundingConfig": "grounding.config",
    "InversionConfig": "grounding.inversion",
    "PolicySet": "rollouts.policies",
    "RolloutPolicies": "rollouts.rollout",
    "TargetLog": "rollouts.target_log",
    "diagnose": "diagnosis",
    "ground": "grounding.ensemble",
    "ground_ensemble": "grounding.ensemble",
    "invert_ensemble": "grounding.ensemble",
}

__all__ = [
    "GroundedEnv",
    "GroundingConfig",
    "InversionConfig",
    "PolicySet",
    "RolloutPolicies",
    "TargetLog",
    "diagnose",
    "ground",
    "ground_ensemble",
    "invert_ensemble",
]


def __getattr__(name: str) -> Any:
    """Either half is imported when it is first asked for: the diagnosis needs neither JAX nor the environments."""
    if name not in _HOME:
        raise AttributeError(f"module 'mpge_jax' has no attribute '{name}'")
    return getattr(importlib.import_module(f"mpge_jax.{_HOME[name]}"), name)
