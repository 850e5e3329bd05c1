"""Force that no effect of the vocabulary explains."""

from mpge_jax.diagnosis.effects.residual import family

__all__ = ["family"]
