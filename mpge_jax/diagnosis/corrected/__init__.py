"""The machine with its effects: as MJCF, in C, in JAX, and as a task."""

from mpge_jax.diagnosis.corrected.corrected_model import CorrectedModel
from mpge_jax.diagnosis.corrected.tasks import nominal_spec, recordings_of, task_env

__all__ = ["CorrectedModel", "nominal_spec", "recordings_of", "task_env"]
