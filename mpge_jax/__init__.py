"""MPGE in JAX: grounding a simulator in a target's dynamics, policies that carry over, and what the simulator lacks."""

from mpge_jax.diagnosis import diagnose
from mpge_jax.ensemble import ground, ground_ensemble, invert_ensemble
from mpge_jax.grounded_env import GroundedEnv
from mpge_jax.grounding_config import GroundingConfig
from mpge_jax.inversion import InversionConfig
from mpge_jax.policies import PolicySet
from mpge_jax.rollout import RolloutPolicies
from mpge_jax.target_log import TargetLog

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
