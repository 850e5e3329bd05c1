"""Trust region policy optimisation (Schulman et al., 2015, https://arxiv.org/abs/1502.05477).

Maximises the surrogate `mean(ratio * advantage)` within `mean KL(old || new) <= max_kl`: natural gradient by
conjugate gradient on Fisher-vector products, then a backtracking line search. All but the line search costs
the same whatever the data, so members of a vmap hardly wait for each other.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from flax import struct
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from mpge_jax.learning.distributions import gaussian_entropy, gaussian_kl, gaussian_log_prob
from mpge_jax.learning.policy_gradient import Distribution, Metrics, Params, PolicyBatch, standardise


@dataclass(frozen=True)
class TRPOConfig:
    """Settings of one TRPO update; the defaults are those of the MPGE authors' experiments.

    Attributes:
      max_kl: trust region, nats.
      cg_iterations: conjugate-gradient steps, always all of them.
      damping: added to the diagonal of the Fisher matrix.
      fisher_stride: the Fisher matrix is estimated on every so-many-th row of the batch.
      line_search_steps: step lengths tried, 1, 1/2, 1/4, ...; if none is accepted the policy stays as it was.
      accept_kl_ratio: a step is accepted with KL up to this multiple of `max_kl`.
    """

    max_kl: float = 0.01
    cg_iterations: int = 15
    damping: float = 0.1
    fisher_stride: int = 5
    line_search_steps: int = 10
    accept_kl_ratio: float = 1.5

    def __post_init__(self) -> None:
        for name in ("max_kl", "cg_iterations", "fisher_stride", "line_search_steps", "accept_kl_ratio"):
            if not getattr(self, name) > 0:
                raise ValueError(f"TRPOConfig: {name} must be positive, got {getattr(self, name)}.")
        if self.damping < 0:
            raise ValueError(f"TRPOConfig: damping must not be negative, got {self.damping}.")


class TRPOState(struct.PyTreeNode):
    """TRPO remembers nothing but the policy."""

    params: Params


def init(params: Params, config: TRPOConfig) -> TRPOState:
    """State from the parameters of a policy; `config` is there for the interface shared with `ppo`."""
    del config
    return TRPOState(params=params)


def update(
    state: TRPOState, batch: PolicyBatch, key: PRNGKeyArray, distribution: Distribution, config: TRPOConfig
) -> tuple[TRPOState, Metrics]:
    """One trust-region step on `batch`. Deterministic: `key` is there for the interface shared with `ppo`.

    Returns:
      The new state and metrics, each `[]`: `kl` (nats, old to new), `improvement` of the surrogate (in
      standard deviations of the advantage), `step_fraction` (accepted step length, 0 where all were refused),
      `entropy` (nats, after the update), `gradient_norm`.
    """
    del key
    flat, unravel = ravel_pytree(state.params)
    advantages = standardise(batch.advantages)
    old_mean, old_log_std = distribution(state.params, batch.inputs)

    def surrogate_and_kl(flat_params: Float[Array, " P"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        mean, log_std = distribution(unravel(flat_params), batch.inputs)
        ratio = jnp.exp(gaussian_log_prob(batch.actions, mean, log_std) - batch.log_probs)
        kl = gaussian_kl(old_mean, old_log_std, mean, log_std)
        return jnp.mean(ratio * advantages), jnp.mean(kl)

    before, gradient = jax.value_and_grad(lambda p: surrogate_and_kl(p)[0])(flat)
    fisher = fisher_vector_product(
        lambda p: distribution(unravel(p), batch.inputs[:: config.fisher_stride]), flat, config.damping
    )
    direction = conjugate_gradient(fisher, gradient, config.cg_iterations)
    # The quadratic model of the KL, 1/2 x'Fx, equals max_kl at the end of the full step.
    model_kl = 0.5 * jnp.vdot(direction, fisher(direction))
    full_step = direction * jnp.sqrt(config.max_kl / jnp.maximum(model_kl, 1e-20))
    fraction, after, kl = line_search(surrogate_and_kl, flat, full_step, before, config)

    # Where every step was refused, full_step itself may hold NaN.
    params = unravel(jnp.where(fraction > 0.0, flat + fraction * full_step, flat))
    metrics = {
        "kl": kl,
        "improvement": after - before,
        "step_fraction": fraction,
        "entropy": jnp.mean(gaussian_entropy(distribution(params, batch.inputs[:1])[1])),
        "gradient_norm": jnp.linalg.norm(gradient),
    }
    return TRPOState(params=params), metrics


def fisher_vector_product(
    outputs: Callable[[Float[Array, " P"]], tuple[Float[Array, "B A"], Float[Array, "B A"]]],
    flat: Float[Array, " P"],
    damping: float,
) -> Callable[[Float[Array, " P"]], Float[Array, " P"]]:
    """`v -> (F + damping I) v`, with F the Fisher matrix of `outputs(flat) = (mean, log_std)`.

    F is the mean over rows, in Gauss-Newton form `J' M J / B`. M, the Fisher matrix of a diagonal Gaussian,
    is 1 / sigma^2 on the mean and 2 on log_std, so F is the Hessian of the mean KL. The network is linearised
    once.
    """
    (mean, log_std), jvp = jax.linearize(outputs, flat)
    vjp = jax.linear_transpose(jvp, flat)
    precision = jnp.exp(-2.0 * log_std)
    rows = mean.shape[0]

    def product(vector: Float[Array, " P"]) -> Float[Array, " P"]:
        mean_dot, log_std_dot = jvp(vector)
        (result,) = vjp((precision * mean_dot / rows, 2.0 * log_std_dot / rows))
        return result + damping * vector

    return product


def conjugate_gradient(
    product: Callable[[Float[Array, " P"]], Float[Array, " P"]], target: Float[Array, " P"], iterations: int
) -> Float[Array, " P"]:
    """Approximate solution x of `A x = target` for symmetric positive definite A, from x = 0.

    Always `iterations` products; once the residual has vanished the rest change nothing.
    """

    Carry = tuple[Float[Array, " P"], Float[Array, " P"], Float[Array, " P"], Float[Array, ""]]

    def step(_: Int[Array, ""], carry: Carry) -> Carry:
        x, residual, search, squared = carry
        image = product(search)
        alive = squared > vanished
        alpha = jnp.where(alive, squared / jnp.where(alive, jnp.vdot(search, image), 1.0), 0.0)
        x = x + alpha * search
        residual = residual - alpha * image
        new_squared = jnp.vdot(residual, residual)
        beta = jnp.where(alive, new_squared / jnp.where(alive, squared, 1.0), 0.0)
        return x, residual, residual + beta * search, new_squared

    squared = jnp.vdot(target, target)
    vanished = 1e-12 * squared
    start = (jnp.zeros_like(target), target, target, squared)
    return jax.lax.fori_loop(0, iterations, step, start)[0]


def line_search(
    surrogate_and_kl: Callable[[Float[Array, " P"]], tuple[Float[Array, ""], Float[Array, ""]]],
    flat: Float[Array, " P"],
    full_step: Float[Array, " P"],
    before: Float[Array, ""],
    config: TRPOConfig,
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """The longest of the steps 1, 1/2, ... that keeps to the trust region and does not lower the surrogate.

    Returns:
      `(fraction, surrogate, kl)` at the accepted step; `(0, before, 0)` where none was.
    """

    Carry = tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""], Float[Array, ""]]

    def searching(carry: Carry) -> Bool[Array, ""]:
        tries, fraction, _, _ = carry
        return (tries < config.line_search_steps) & (fraction == 0.0)

    def attempt(carry: Carry) -> Carry:
        tries, _, _, _ = carry
        fraction = 0.5**tries
        after, kl = surrogate_and_kl(flat + fraction * full_step)
        # Comparisons with NaN are false, so a step that overflows is refused.
        accepted = (kl <= config.accept_kl_ratio * config.max_kl) & (after >= before)
        return (
            tries + 1.0,
            jnp.where(accepted, fraction, 0.0),
            jnp.where(accepted, after, before),
            jnp.where(accepted, kl, 0.0),
        )

    # A loop that stops early: the first try is nearly always accepted, and under vmap it never runs longer
    # than the fixed count would.
    zero = jnp.zeros_like(before)
    _, fraction, after, kl = jax.lax.while_loop(searching, attempt, (zero, zero, before, zero))
    return fraction, after, kl
