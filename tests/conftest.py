"""Strict numerics for the whole suite; warnings are errors by pyproject.toml."""

import jax
import mujoco

# A [B] reward broadcast against a [B, 1] value is a bug that trains: it must fail, not broadcast.
jax.config.update("jax_numpy_rank_promotion", "raise")

# MuJoCo's warnings go to the console, where pytest captures them, and to no file in the working folder.
_log = mujoco.MjLogConfig.get()
_log.logto_file = False
_log.set()
