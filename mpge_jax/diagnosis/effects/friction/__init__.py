"""Friction and damping at a joint."""

from mpge_jax.diagnosis.effects.friction import damping, dry, hidden

__all__ = ["damping", "dry", "hidden"]
