"""MPGE in JAX: grounding a simulator in a target's dynamics, policies that carry over, and what the simulator lacks."""

from mpge_jax.diagnosis import diagnose
from mpge_jax.grounding.config import GroundingConfig
from mpge_jax.grounding.ensemble import ground, ground_ensemble, invert_ensemble
from mpge_jax.grounding.grounded_env import GroundedEnv
from mpge_jax.grounding.inversion import InversionConfig
from mpge_jax.rollouts.policies import PolicySet
from mpge_jax.rollouts.rollout import RolloutPolicies
from mpge_jax.rollouts.target_log import TargetLog

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
