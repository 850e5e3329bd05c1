"""The machine with its effects: as MJCF, in C, in JAX, and as a task."""
