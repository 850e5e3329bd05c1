"""Strict numerics and shapes for the whole suite; warnings are errors by pyproject.toml."""

import os
import tempfile
from importlib.metadata import version
from pathlib import Path

# Nearly all the time of the tests is compilation of programs that run once: LLVM optimises none of them, XLA's older,
# plainer code is compiled twice as fast as that of its fusion emitters, and programs are compiled whole, where parts
# serve more threads (jaxlib 0.11 ends the process at a flag that it does not know). Before JAX.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_optimization_level=0"
    + (
        " --xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
        if version("jaxlib").startswith("0.10.")
        else ""
    ),
)

import hypothesis
import jax
import jaxtyping
import mujoco
import pytest

from tests import shape_checks

# Before anything imports these modules; `tests.shape_checks` imports none of them.
jaxtyping.install_import_hook(shape_checks.MODULES, "tests.shape_checks.check")

# A [B] reward broadcast against a [B, 1] value is a bug that trains: it must fail, not broadcast.
jax.config.update("jax_numpy_rank_promotion", "raise")

# A program that several tests compile is compiled once a process. For this run alone: a file half written is no entry.
_compiled = tempfile.TemporaryDirectory(prefix="jax-programs-", ignore_cleanup_errors=True)
jax.config.update("jax_compilation_cache_dir", _compiled.name)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.03)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

# MuJoCo's warnings go to the console, where pytest captures them, and to no file in the working folder.
_log = mujoco.MjLogConfig.get()
_log.logto_file = False
_log.set()


# The same examples at each run: a change is refused for what it does. HYPOTHESIS=default looks for others.
hypothesis.settings.register_profile("same_examples", derandomize=True, database=None)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS", "same_examples"))


# The files that take longest come first. A process runs one at a time: it should not be alone with it at the end.
LONG = (
    "diagnosis/effects/test_effects.py", "diagnosis/estimation/test_fits.py", "diagnosis/machine/test_contacts.py",
    "diagnosis/measurement/test_delay_within_a_row.py", "diagnosis/measurement/test_encoder_zeros.py",
    "diagnosis/report/test_next_experiment.py", "diagnosis/selection/test_decisions.py",
    "diagnosis/test_diagnose_command.py", "experiments/test_sweep.py", "grounding/test_early_stop.py",
    "grounding/test_ensemble.py", "grounding/test_grounding.py", "grounding/test_grounding_update.py",
    "learning/test_sac.py", "test_edges.py", "test_readme.py",
)  # fmt: skip


def pytest_collection_modifyitems(items):
    tests = Path(__file__).parent
    first = [tests / name for name in LONG]
    assert all(path.is_file() for path in first), "a file of LONG is gone"
    items.sort(key=lambda item: item.path not in first)


@pytest.fixture
def brax_on_new_jax(monkeypatch):
    """What brax 0.14.2's trainers ask for and JAX 0.10 no longer has: one copy of a tree for each device."""
    if not hasattr(jax, "device_put_replicated"):

        def copies(tree, devices):
            return jax.tree.map(lambda x: jax.numpy.stack([x] * len(devices)), tree)

        monkeypatch.setattr(jax, "device_put_replicated", copies, raising=False)


@pytest.fixture
def own_registry(monkeypatch):
    """Tasks and variants that a test registers are gone after it."""
    # not above: `tests.shape_checks` comes before whatever it checks
    from envs import registry

    for name in ("_tasks", "_variants", "_homes"):
        monkeypatch.setattr(registry, name, dict(getattr(registry, name)))


@pytest.fixture
def unchecked(monkeypatch):
    """Without the checks of shapes, as the library is used: where its own answer to a wrong shape is tested."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
