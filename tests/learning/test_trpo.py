"""TRPO: every part against explicit linear algebra, the whole on a bandit with a known answer."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from mpge_jax.grounding import transformer
from mpge_jax.learning import trpo
from mpge_jax.learning.distributions import gaussian_kl, gaussian_log_prob
from mpge_jax.learning.policy_gradient import standardise
from tests.learning import bandit

update = jax.jit(trpo.update, static_argnames=("distribution", "config"))


def random_policy(seed=0, log_std=-0.3):
    """A policy whose mean is not nearly zero, and a batch of its decisions."""
    params = bandit.policy_params(jax.random.key(seed))
    noise = jax.random.normal(jax.random.key(seed + 1), ravel_pytree(params)[0].shape)
    flat, unravel = ravel_pytree(params)
    params = unravel(flat + 0.3 * noise) | {"log_std": jnp.full(1, log_std)}
    return params, bandit.batch(params, jax.random.key(seed + 2), 40)


def log_prob(params, batch):
    return gaussian_log_prob(batch.actions, *transformer.apply(params, batch.inputs))


@jax.jit
def explicit_fisher(params, inputs):
    """Mean over rows of J' diag(1 / sigma^2) J for the mean and J' diag(2) J for log_std, J written out."""
    flat, unravel = ravel_pytree(params)
    mean_jacobian = jax.jacobian(lambda p: transformer.apply(unravel(p), inputs)[0])(flat)
    log_std_jacobian = jax.jacobian(lambda p: transformer.apply(unravel(p), inputs)[1])(flat)
    precision = jnp.exp(-2.0 * transformer.apply(params, inputs)[1])
    total = jnp.einsum("bap,ba,baq->pq", mean_jacobian, precision, mean_jacobian)
    total += 2.0 * jnp.einsum("bap,baq->pq", log_std_jacobian, log_std_jacobian)
    return total / inputs.shape[0]


def test_fisher_vector_product_is_the_explicit_matrix():
    params, batch = random_policy()
    flat, unravel = ravel_pytree(params)
    product = trpo.fisher_vector_product(lambda p: transformer.apply(unravel(p), batch.inputs), flat, 0.1)
    matrix = explicit_fisher(params, batch.inputs) + 0.1 * jnp.eye(flat.size)
    np.testing.assert_allclose(jax.jit(jax.vmap(product))(jnp.eye(flat.size)), matrix, rtol=1e-4, atol=1e-5)


def test_fisher_matrix_is_the_hessian_of_the_kl():
    params, batch = random_policy()
    flat, unravel = ravel_pytree(params)
    old = transformer.apply(params, batch.inputs)
    divergence = lambda p: gaussian_kl(*old, *transformer.apply(unravel(p), batch.inputs)).mean()  # noqa: E731
    hessian = jax.jit(jax.hessian(divergence))(flat)
    np.testing.assert_allclose(explicit_fisher(params, batch.inputs), hessian, rtol=1e-3, atol=1e-4)


def test_fisher_by_hand():
    # mean = w x, log_std = l, rows x = 1 and 3, sigma = 1/2: F = diag(4 (1 + 9) / 2, 2) = diag(20, 2)
    x = jnp.array([[1.0], [3.0]])
    flat = jnp.array([0.7, np.log(0.5)], jnp.float32)
    product = trpo.fisher_vector_product(
        lambda p: (p[0] * x, jnp.broadcast_to(p[1], x.shape)), flat, damping=0.0
    )
    np.testing.assert_allclose(product(jnp.array([1.0, 0.0])), [20.0, 0.0], rtol=1e-5)
    np.testing.assert_allclose(product(jnp.array([0.0, 1.0])), [0.0, 2.0], rtol=1e-5)


def test_conjugate_gradient_is_a_solve():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6)).astype(np.float32)
    matrix, target = root @ root.T + np.eye(6, dtype=np.float32), rng.normal(size=6).astype(np.float32)
    x = trpo.conjugate_gradient(lambda v: jnp.asarray(matrix) @ v, jnp.asarray(target), 15)
    np.testing.assert_allclose(x, np.linalg.solve(matrix, target), rtol=2e-3, atol=1e-4)


def test_conjugate_gradient_one_step_by_hand():
    # A = diag(1, 4), b = (1, 1): x = (b.b / b.Ab) b = 2/5 (1, 1)
    x = trpo.conjugate_gradient(lambda v: jnp.array([1.0, 4.0]) * v, jnp.ones(2), 1)
    np.testing.assert_allclose(x, [0.4, 0.4], rtol=1e-6)


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_conjugate_gradient_stays_put_once_solved(scale):
    # Solved after one step; the other fourteen would divide zero by zero.
    x = trpo.conjugate_gradient(lambda v: 2.0 * v, jnp.full(3, scale), 15)
    np.testing.assert_allclose(x, np.full(3, scale / 2), rtol=1e-6)
    np.testing.assert_array_equal(trpo.conjugate_gradient(lambda v: 2.0 * v, jnp.zeros(3), 15), np.zeros(3))


def search(surrogate, kl, **settings):
    """Line search along one parameter from 0 with a full step of 1; `surrogate(0)` must be 0."""
    config = trpo.TRPOConfig(max_kl=1.0, accept_kl_ratio=1.5, **settings)
    result = trpo.line_search(
        lambda p: (surrogate(p[0]), kl(p[0])), jnp.zeros(1), jnp.ones(1), jnp.zeros(()), config
    )
    return tuple(float(x) for x in result)


def test_line_search_takes_the_full_step_when_it_may():
    assert search(lambda x: 3.0 * x, lambda x: 1.5 * x) == (1.0, 3.0, 1.5)


def test_line_search_halves_until_the_kl_fits():
    # kl 8x: 8, 4, 2 are above 1.5, 1 is not
    assert search(lambda x: x, lambda x: 8.0 * x) == (0.125, 0.125, 1.0)


def test_line_search_halves_until_the_surrogate_is_no_worse():
    # x (0.3 - x): negative at 1 and 1/2, positive at 1/4
    fraction, after, _ = search(lambda x: x * (0.3 - x), lambda x: 0.0 * x)
    assert fraction == 0.25
    assert after == pytest.approx(0.0125, rel=1e-4)


def test_line_search_refuses_all():
    assert search(lambda x: -x, lambda x: 0.0 * x) == (0.0, 0.0, 0.0)


def test_line_search_refuses_nan():
    assert search(lambda x: x, lambda x: jnp.where(x > 0.3, jnp.nan, x)) == (0.25, 0.25, 0.25)


def test_line_search_stops_after_its_last_try():
    # 2^-9 would be accepted: the tenth try, but not within nine.
    needed = 1.5 * 2.0**9
    assert search(lambda x: x, lambda x: needed * x, line_search_steps=10)[0] == 2.0**-9
    assert search(lambda x: x, lambda x: needed * x, line_search_steps=9)[0] == 0.0


@pytest.mark.parametrize("stride", [1, 5])
def test_step_is_the_scaled_natural_gradient(stride):
    params, batch = random_policy()
    config = trpo.TRPOConfig(fisher_stride=stride, cg_iterations=200, max_kl=1e-4, damping=0.1)
    state, metrics = update(trpo.init(params, config), batch, jax.random.key(0), transformer.apply, config)
    flat, unravel = ravel_pytree(params)
    advantages = (batch.advantages - batch.advantages.mean()) / batch.advantages.std()
    gradient = jax.grad(
        lambda p: jnp.mean(jnp.exp(log_prob(unravel(p), batch) - batch.log_probs) * advantages)
    )(flat)
    fisher = np.asarray(explicit_fisher(params, batch.inputs[::stride]), np.float64) + 0.1 * np.eye(flat.size)
    direction = np.linalg.solve(fisher, np.asarray(gradient, np.float64))
    expected = direction * np.sqrt(2 * 1e-4 / (direction @ fisher @ direction))
    taken = ravel_pytree(state.params)[0] - flat
    assert float(metrics["step_fraction"]) == 1.0
    assert float(metrics["gradient_norm"]) == pytest.approx(float(jnp.linalg.norm(gradient)), rel=1e-4)
    np.testing.assert_allclose(taken, expected, rtol=0.02, atol=2e-3 * np.abs(expected).max())


def test_metrics_describe_the_step():
    params, batch = random_policy()
    config = trpo.TRPOConfig()
    state, metrics = update(trpo.init(params, config), batch, jax.random.key(0), transformer.apply, config)
    old, new = (transformer.apply(p, batch.inputs) for p in (params, state.params))
    assert 0.0 < float(metrics["kl"]) <= 1.5 * config.max_kl
    assert float(metrics["kl"]) == pytest.approx(float(gaussian_kl(*old, *new).mean()), rel=1e-3)
    advantages = standardise(batch.advantages)
    ratio = jnp.exp(log_prob(state.params, batch) - batch.log_probs)
    gained = float(jnp.mean(ratio * advantages) - jnp.mean(advantages))
    assert float(metrics["improvement"]) == pytest.approx(gained, abs=1e-5)
    assert gained > 0
    expected = float(state.params["log_std"].sum()) + 0.5 * np.log(2 * np.pi * np.e)
    assert float(metrics["entropy"]) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("advantages", [jnp.full(40, 7.0), jnp.full(40, jnp.nan)])
def test_policy_stays_where_there_is_nothing_to_learn(advantages):
    params, batch = random_policy()
    config = trpo.TRPOConfig()
    state, _ = update(
        trpo.init(params, config),
        batch.replace(advantages=advantages),
        jax.random.key(0),
        transformer.apply,
        config,
    )
    jax.tree.map(np.testing.assert_array_equal, state.params, params)


def test_bandit_is_solved():
    state, metrics = bandit.solve(trpo, trpo.TRPOConfig(max_kl=0.03), seed=0, updates=60, size=512)
    assert float(bandit.error(bandit.policy_params(jax.random.key(0)))) > 0.4
    assert float(bandit.error(state.params)) < 0.05
    assert float(metrics["kl"].max()) <= 1.5 * 0.03


def test_vmap_equals_separate_runs():
    config = trpo.TRPOConfig()

    def run(params, batch):
        return trpo.update(trpo.init(params, config), batch, jax.random.key(0), transformer.apply, config)

    members = [random_policy(seed) for seed in (0, 10)]
    # The last learns nothing, so its line search goes on while the others' have ended.
    members.append((members[0][0], members[0][1].replace(advantages=jnp.full(40, jnp.nan))))
    together = jax.jit(jax.vmap(run))(*jax.tree.map(lambda *x: jnp.stack(x), *members))
    alone = [jax.jit(run)(*member) for member in members]
    compare = partial(np.testing.assert_allclose, rtol=1e-3, atol=1e-4)
    jax.tree.map(compare, together, jax.tree.map(lambda *x: np.stack(x), *alone))


@pytest.mark.parametrize("name", ["max_kl", "cg_iterations", "fisher_stride", "line_search_steps"])
def test_configuration_is_checked(name):
    with pytest.raises(ValueError, match=f"TRPOConfig: {name} must be positive, got 0"):
        dataclasses.replace(trpo.TRPOConfig(), **{name: 0})
