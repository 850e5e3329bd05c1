"""Masses, where they are, and what nobody knows of the given ones."""

from mpge_jax.diagnosis.effects.inertia import extended_payload, given, masses

__all__ = ["extended_payload", "given", "masses"]
