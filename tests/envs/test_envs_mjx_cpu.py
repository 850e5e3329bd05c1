"""MJX on CPU steps without LAPACK, whose batched calls wait for each other for ever (docs/mjx-on-cpu.md)."""

import re
import subprocess
import sys
import threading
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs
from envs._mjx import _factor, _solve, without_lapack

ROOT = Path(__file__).resolve().parents[2]
COPIES = 4096

MANY = f"""
import jax, numpy as np
import envs

env = envs.make("BrokenCheetah", backend="mjx")
state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), {COPIES}))
step = jax.jit(jax.vmap(env.step))
for seed in range(20):
    actions = np.random.default_rng(seed).uniform(-1, 1, ({COPIES}, env.action_size)).astype(np.float32)
    state = jax.block_until_ready(step(state, actions))
    assert np.isfinite(state.obs).all() and np.isfinite(state.reward).all(), seed
print("stepped")
"""


def ours(a):
    """`cho_factor` as MJX gets it."""
    with without_lapack():
        return jax.scipy.linalg.cho_factor(a)[0]


def lowered(function, platform, *arguments):
    return jax.jit(function).trace(*arguments).lower(lowering_platforms=(platform,)).as_text()


# The machine that stood still; the others take the same way through the solver.
SOURCES = [
    pytest.param(name, marks=[] if name == "HalfCheetah" else pytest.mark.slow)
    for name in sorted({envs.source_of(name) for name in envs.names()})
]


@pytest.mark.parametrize("name", SOURCES)
def test_a_step_calls_no_lapack(name):
    """So what waits for ever is not there, however many copies and cores. (A variant's step differs in numbers.)"""
    env = envs.make(name, backend="mjx")
    state = jax.eval_shape(jax.vmap(env.reset), jax.random.split(jax.random.key(0), 4))
    actions = jax.ShapeDtypeStruct((4, env.action_size), jnp.float32)
    program = lowered(jax.vmap(env.step), "cpu", state, actions)
    assert "stablehlo.while" in program
    assert not re.findall(r"custom_call @\w+", program)


def test_other_platforms_get_what_mjx_asked_for():
    a = jnp.eye(3)
    assert "lapack" in lowered(lambda a: jax.scipy.linalg.cho_factor(a)[0], "cpu", a)
    assert "cholesky" not in lowered(ours, "cpu", a)
    assert "stablehlo.cholesky" in lowered(ours, "tpu", a)


def test_factor_and_solve():
    u = jnp.array([[2.0, 1.0], [0.0, 3.0]])
    a = jnp.array([[4.0, 2.0], [2.0, 10.0]])
    np.testing.assert_array_equal(_factor(a), u)
    np.testing.assert_allclose(_solve(u, jnp.array([8.0, 22.0])), [1.0, 2.0], rtol=1e-6)
    np.testing.assert_array_equal(ours(a), u)

    matrices = jax.random.normal(jax.random.key(0), (50, 9, 9))
    matrices = matrices @ matrices.mT + jnp.eye(9)[None]
    sides = jax.random.normal(jax.random.key(1), (50, 9))
    factors = jax.jit(jax.vmap(_factor))(matrices)
    np.testing.assert_allclose(factors, np.linalg.cholesky(matrices).mT, atol=1e-5)
    exact = np.linalg.solve(np.asarray(matrices, np.float64), np.asarray(sides, np.float64)[..., None])[
        ..., 0
    ]
    np.testing.assert_allclose(jax.jit(jax.vmap(_solve))(factors, sides), exact, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("last", [0.0, -1.0, jnp.nan])
def test_what_has_no_factor_is_nan_as_in_jax(last):
    a = jnp.diag(jnp.array([1.0, last, 1.0]))
    assert np.isnan(jax.scipy.linalg.cho_factor(a)[0]).any()
    factor = _factor(a)
    assert np.isnan(factor).all()
    assert np.isnan(_solve(factor, jnp.ones(3))).all()


def test_only_mjx_and_only_for_the_moment():
    """Lower factors, batches and other threads have JAX's own."""
    a = jnp.array([[4.0, 2.0], [2.0, 10.0]])
    before = jax.scipy.linalg.cho_factor, jax.scipy.linalg.cho_solve
    programs = {}

    def elsewhere():
        programs["thread"] = lowered(lambda a: jax.scipy.linalg.cho_factor(a)[0], "cpu", a)

    with pytest.raises(RuntimeError, match="from MJX"), without_lapack():
        lower = jax.scipy.linalg.cho_factor(a, lower=True)
        np.testing.assert_allclose(lower[0], [[2.0, 0.0], [1.0, 3.0]], rtol=1e-6)
        sides = jnp.array([8.0, 22.0])
        np.testing.assert_allclose(jax.scipy.linalg.cho_solve(lower, sides), [1.0, 2.0], rtol=1e-6)
        both = jax.scipy.linalg.cho_factor(jnp.stack([a, a]))
        np.testing.assert_allclose(
            jax.scipy.linalg.cho_solve(both, jnp.stack([sides, sides])[..., None])[1, :, 0],
            [1.0, 2.0],
            rtol=1e-6,
        )
        thread = threading.Thread(target=elsewhere)
        thread.start()
        thread.join()
        raise RuntimeError("from MJX")
    assert "lapack" in programs["thread"]
    assert (jax.scipy.linalg.cho_factor, jax.scipy.linalg.cho_solve) == before


@pytest.mark.slow
def test_many_copies_step_to_the_end():
    command = [sys.executable, "-c", MANY]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=1200)
    assert (done.returncode, done.stdout) == (0, "stepped\n"), done.stderr
