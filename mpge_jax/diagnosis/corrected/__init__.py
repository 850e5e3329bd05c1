"""The machine with its effects: as MJCF, in C, in JAX, and as a task (`tasks`, which alone needs the environments)."""

from mpge_jax.diagnosis.corrected.corrected_model import CorrectedModel

__all__ = ["CorrectedModel"]
