"""Strict numerics and shapes for the whole suite; warnings are errors by pyproject.toml."""

import os

# Nearly all the time of the tests is compilation of programs that run once: LLVM optimises none of them. Before JAX.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")

import jax
import jaxtyping
import mujoco
import pytest

from tests import shape_checks

# Before anything imports these modules; `tests.shape_checks` imports none of them.
jaxtyping.install_import_hook(shape_checks.MODULES, "tests.shape_checks.check")

# A [B] reward broadcast against a [B, 1] value is a bug that trains: it must fail, not broadcast.
jax.config.update("jax_numpy_rank_promotion", "raise")

# MuJoCo's warnings go to the console, where pytest captures them, and to no file in the working folder.
_log = mujoco.MjLogConfig.get()
_log.logto_file = False
_log.set()


@pytest.fixture
def unchecked(monkeypatch):
    """Without the checks of shapes, as the library is used: where its own answer to a wrong shape is tested."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
