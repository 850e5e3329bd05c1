"""Action transformers: trained adversarially or by inversion, judged, and put before a simulator."""

from mpge_jax import own_envs as own_envs
