"""Friction and damping at a joint."""

from mpge_jax.diagnosis.effects.friction import damped_motor, damping, dry, elastic, falling, gradual, hidden

__all__ = ["damped_motor", "damping", "dry", "elastic", "falling", "gradual", "hidden"]
