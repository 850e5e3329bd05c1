"""Learners and their parts: networks, TRPO, PPO, SAC, value functions, and an agent trained with them."""

from mpge_jax import own_envs as own_envs
