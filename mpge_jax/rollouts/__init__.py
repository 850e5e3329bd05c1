"""Rollout policies and what they record in the target."""
