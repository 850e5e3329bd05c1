"""Rollout policies and what they record in the target."""

from mpge_jax import own_envs as own_envs
