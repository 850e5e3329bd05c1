"""Friction and damping at a joint."""

from mpge_jax.diagnosis.effects.friction import damping, dry, elastic, falling, gradual, hidden

__all__ = ["damping", "dry", "elastic", "falling", "gradual", "hidden"]
