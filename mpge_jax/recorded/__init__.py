"""Recordings of a real target as transitions of a task, and what acted while they were made."""

from mpge_jax import own_envs as own_envs
