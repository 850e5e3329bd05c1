"""The discriminator D(s, a, s'): is a transition the grounded simulator's or the target's?

Signs are named, not remembered: everything below works on `logits_grounded_is_high`, the log-odds that a
transition is grounded, and the reward of the action transformer is high where a transition looks like the
target's. The labels of the paper (grounded 1) and of its authors' experiments (grounded 0) differ by the sign
of the network's output alone.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from flax import struct
from flax.linen.initializers import xavier_uniform
from jaxtyping import Array, Float, PRNGKeyArray

from mpge_jax.learning import normalise
from mpge_jax.learning.networks import MLP, initial
from mpge_jax.learning.policy_gradient import Metrics, Params

# The authors clip D to [1e-8, 1 - 1e-8] before the logarithm.
MAX_REWARD = -math.log(1e-8)


@dataclass(frozen=True)
class DiscriminatorConfig:
    """Settings of the discriminator.

    Attributes:
      hidden: width of each tanh layer.
      learning_rate: of Adam.
      entropy_coefficient: weight of the mean entropy (nats) of D's verdicts, which is to be large.
      penalty_coefficient: weight of the gradient penalty; 0 leaves it out.
      penalty_target: norm that the gradient of the logit is drawn to, on normalised inputs.
      interpolation: where between a grounded and a target row the penalty is taken: at a weight drawn anew
        for every pair ("per_sample", as in WGAN-GP), or at one weight for each feature, drawn once for the
        whole run ("constant", as in the authors' experiments).
      labels: "paper" for grounded 1 and target 0, "release" for the reverse.
      std_floor: least standard deviation that inputs are divided by.
      next_as: how D sees s': as it is ("observation"), or less what the simulator itself answers to (s, a)
        ("residual"): the same D(s, a, s'), which then need not learn the simulator's dynamics first to see
        in what the target differs from them.
    """

    hidden: tuple[int, ...] = (256, 256)
    learning_rate: float = 3e-4
    entropy_coefficient: float = 1e-3
    penalty_coefficient: float = 10.0
    penalty_target: float = 1.0
    interpolation: Literal["per_sample", "constant"] = "per_sample"
    labels: Literal["paper", "release"] = "paper"
    std_floor: float = 0.1
    next_as: Literal["observation", "residual"] = "observation"

    def __post_init__(self) -> None:
        for name in ("learning_rate", "std_floor"):
            if not getattr(self, name) > 0:
                raise ValueError(f"DiscriminatorConfig: {name} must be positive, got {getattr(self, name)}.")
        for name in ("entropy_coefficient", "penalty_coefficient", "penalty_target"):
            if not getattr(self, name) >= 0:
                raise ValueError(
                    f"DiscriminatorConfig: {name} must not be negative, got {getattr(self, name)}."
                )
        choices = (
            ("interpolation", ("per_sample", "constant")),
            ("labels", ("paper", "release")),
            ("next_as", ("observation", "residual")),
        )
        for name, known in choices:
            if getattr(self, name) not in known:
                raise ValueError(
                    f"DiscriminatorConfig: {name} must be one of {known}, got {getattr(self, name)!r}."
                )


class Transitions(struct.PyTreeNode):
    """Transitions (s, a, s').

    `action` is what the rollout policy asked for, in the grounded simulator too: never the transformed one.
    `expected`, for `next_as="residual"` alone, is where the simulator goes under that action.
    """

    observation: Float[Array, "*n O"]
    action: Float[Array, "*n A"]
    next_observation: Float[Array, "*n O"]
    expected: Float[Array, "*n O"] | None = None


class DiscriminatorState(struct.PyTreeNode):
    """A discriminator.

    Attributes:
      params: of the network.
      optimiser: state of Adam.
      stats: over all grounded and target rows learned from: of (s, a), `[O + A]`, or of (s, a, residual),
        `[2 O + A]`.
      interpolation: the weights of "constant" interpolation, `[2 O + A]`.
    """

    params: Params
    optimiser: optax.OptState
    stats: normalise.RunningStats
    interpolation: Float[Array, "*n I"]


_INIT = xavier_uniform()


def _network(config: DiscriminatorConfig) -> nn.Module:
    return MLP((*config.hidden, 1), nn.tanh, hidden_init=_INIT)


def init(
    key: PRNGKeyArray, observation_size: int, action_size: int, config: DiscriminatorConfig
) -> DiscriminatorState:
    """A fresh discriminator that has seen no data. `key` is consumed."""
    network_key, interpolation_key = jax.random.split(key)
    inputs = 2 * observation_size + action_size
    params = initial(_network(config), network_key, inputs)
    return DiscriminatorState(
        params=params,
        optimiser=optax.adam(config.learning_rate).init(params),
        stats=normalise.init(inputs if config.next_as == "residual" else observation_size + action_size),
        interpolation=jax.random.uniform(interpolation_key, (inputs,)),
    )


def _measured(rows: Transitions, config: DiscriminatorConfig) -> Float[Array, "B F"]:
    """The features of `rows` that statistics are kept of."""
    pair = [rows.observation, rows.action]
    if config.next_as == "observation":
        return jnp.concatenate(pair, axis=-1)
    if rows.expected is None:
        raise ValueError(
            'A discriminator with next_as="residual" needs rows with `expected`, see Transitions.'
        )
    return jnp.concatenate([*pair, rows.next_observation - rows.expected], axis=-1)


def network_inputs(
    stats: normalise.RunningStats, rows: Transitions, config: DiscriminatorConfig
) -> Float[Array, "B I"]:
    """`[norm(s, a), norm(s')]`, `[B, 2 O + A]`; s' by the statistics of s, so that the step s' - s survives.

    Or `norm(s, a, residual)`, every feature by its own statistics.

    Raises:
      ValueError: the sizes are not those the discriminator was made for, or `expected` is missing.
    """
    measured = _measured(rows, config)
    if measured.shape[-1] != stats.mean.shape[-1] or rows.next_observation.shape != rows.observation.shape:
        raise ValueError(
            f"This discriminator keeps statistics of {stats.mean.shape[-1]} numbers, got {measured.shape[-1]} from "
            f"shapes {rows.observation.shape}, {rows.action.shape} and {rows.next_observation.shape}; were they "
            "logged in another task?"
        )
    normal = normalise.normalise(stats, measured, config.std_floor)
    if config.next_as == "residual":
        return normal
    size = rows.observation.shape[-1]
    of_s = normalise.RunningStats(stats.count, stats.mean[:size], stats.variance[:size])
    return jnp.concatenate(
        [normal, normalise.normalise(of_s, rows.next_observation, config.std_floor)], axis=-1
    )


def _grounded_is_high(
    params: Params, inputs: Float[Array, "B I"], config: DiscriminatorConfig
) -> Float[Array, " B"]:
    sign = 1.0 if config.labels == "paper" else -1.0
    return sign * _network(config).apply(params, inputs)[..., 0]


def logits_grounded_is_high(
    state: DiscriminatorState, rows: Transitions, config: DiscriminatorConfig
) -> Float[Array, " B"]:
    """Log-odds that each transition is the grounded simulator's."""
    return _grounded_is_high(state.params, network_inputs(state.stats, rows, config), config)


def reward(state: DiscriminatorState, rows: Transitions, config: DiscriminatorConfig) -> Float[Array, " B"]:
    """Reward of the action transformer, in [0, 18.4]: high where a transition may be the target's."""
    return reward_from_logits(logits_grounded_is_high(state, rows, config))


def reward_from_logits(grounded_is_high: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """`-log clip(P(grounded), 1e-8, 1 - 1e-8)`, written so that it neither overflows nor rounds to a step."""
    return jnp.clip(jax.nn.softplus(-grounded_is_high), -math.log1p(-1e-8), MAX_REWARD)


def update(
    state: DiscriminatorState,
    grounded: Transitions,
    target: Transitions,
    key: PRNGKeyArray,
    config: DiscriminatorConfig,
) -> tuple[DiscriminatorState, Metrics]:
    """One gradient step on as many grounded as target rows, B each. `key` is consumed.

    The statistics of the inputs take in both batches first.

    Returns:
      The new state and health metrics, each `[]`, from before the step: `loss`, `gradient_penalty`
      (unweighted), `accuracy_grounded` and `accuracy_target` (share of rows told right), `entropy` (mean,
      nats; log 2 is a coin toss), `logit_gap` (mean grounded logit less mean target logit).
    """
    if grounded.observation.shape != target.observation.shape:
        raise ValueError(
            "discriminator.update: grounded and target rows are taken in pairs and need one shape, got "
            f"{grounded.observation.shape} and {target.observation.shape}."
        )
    both = jax.tree.map(lambda g, t: jnp.concatenate([g, t]), grounded, target)
    stats = normalise.update(state.stats, _measured(both, config))
    inputs = network_inputs(stats, both, config)
    rows = grounded.observation.shape[0]
    per_sample = config.interpolation == "per_sample"
    weight = jax.random.uniform(key, (rows, 1)) if per_sample else state.interpolation[None]

    (_, metrics), gradient = jax.value_and_grad(loss, has_aux=True)(
        state.params, inputs[:rows], inputs[rows:], weight, config
    )
    change, optimiser = optax.adam(config.learning_rate).update(gradient, state.optimiser)
    params = optax.apply_updates(state.params, change)
    return replace(state, params=params, optimiser=optimiser, stats=stats), metrics


def loss(
    params: Params,
    grounded: Float[Array, "B I"],
    target: Float[Array, "B I"],
    weight: Float[Array, "#B #I"],
    config: DiscriminatorConfig,
) -> tuple[Float[Array, ""], Metrics]:
    """Cross-entropy of each side, less the entropy bonus, plus the gradient penalty; and the health metrics.

    The cross-entropies are equation (2) of Lee et al. (IJCAI 2022): the rows of all K rollout policies, one D.

    Args:
      grounded: normalised inputs; `target` likewise.
      weight: of the grounded row in the interpolation, `[B, 1]` or `[1, I]`.
    """
    rows = grounded.shape[0]
    logits = _grounded_is_high(params, jnp.concatenate([grounded, target]), config)
    of_grounded, of_target = logits[:rows], logits[rows:]
    cross_entropy = jnp.mean(jax.nn.softplus(-of_grounded)) + jnp.mean(jax.nn.softplus(of_target))
    entropy = jnp.mean(jax.nn.softplus(-logits) + logits * jax.nn.sigmoid(-logits))
    penalty = gradient_penalty(params, weight * grounded + (1.0 - weight) * target, config)
    total = cross_entropy - config.entropy_coefficient * entropy + config.penalty_coefficient * penalty
    return total, {
        "loss": total,
        "gradient_penalty": penalty,
        "accuracy_grounded": jnp.mean((of_grounded > 0).astype(jnp.float32)),
        "accuracy_target": jnp.mean((of_target < 0).astype(jnp.float32)),
        "entropy": entropy,
        "logit_gap": jnp.mean(of_grounded) - jnp.mean(of_target),
    }


def gradient_penalty(
    params: Params, inputs: Float[Array, "B I"], config: DiscriminatorConfig
) -> Float[Array, ""]:
    """`mean (|d logit / d input| - target)^2` over `inputs` (Gulrajani et al., 2017, equation 3)."""
    # Rows do not influence each other, so the gradient of the sum holds every row's own gradient.
    slopes = jax.grad(lambda x: jnp.sum(_grounded_is_high(params, x, config)))(inputs)
    # The derivative of a norm at zero is undefined; the small term keeps it finite.
    norms = jnp.sqrt(jnp.sum(slopes**2, axis=-1) + 1e-12)
    return jnp.mean((norms - config.penalty_target) ** 2)
