"""Supervised action transformation: invert the simulator on the target's transitions, then regress (GAT).

For a logged (s, a, s'), the action a~ that takes the simulator from s to s' is found by Levenberg-Marquardt with
finite differences (all transitions batched), and pi_g is fitted to the residual a~ - a. The idea is grounded action
transformation's (Hanna and Stone, AAAI 2017), with the simulator itself in place of a learned inverse model.

Shapes: `B` transitions, `O` observation, `A` action size.
"""

from dataclasses import dataclass, field
from typing import Any

import flax.struct
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, PRNGKeyArray

from envs import Env
from mpge_jax.grounding import transformer
from mpge_jax.grounding.transformer import Transformer, TransformerConfig
from mpge_jax.learning.policy_gradient import Params
from mpge_jax.rollouts.target_log import TargetLog


@dataclass(frozen=True)
class InversionConfig:
    """How transitions are inverted and the residuals regressed.

    Attributes:
      transformer: the network to fit.
      iterations: Levenberg-Marquardt steps.
      difference: step of the finite differences, as a share of the action range.
      learning_rate: of Adam, at its start; it falls to 0 on a cosine.
      weight_decay: of AdamW.
      epochs: passes over the log.
      minibatch_size: rows of one gradient step.
    """

    transformer: TransformerConfig = field(default_factory=TransformerConfig)
    iterations: int = 8
    difference: float = 5e-3
    learning_rate: float = 3e-3
    weight_decay: float = 0.1
    epochs: int = 400
    minibatch_size: int = 128

    def __post_init__(self) -> None:
        for name in ("iterations", "difference", "learning_rate", "epochs", "minibatch_size"):
            if not getattr(self, name) > 0:
                raise ValueError(f"InversionConfig: {name} must be positive, got {getattr(self, name)}.")
        if self.weight_decay < 0:
            raise ValueError(f"InversionConfig: weight_decay must not be negative, got {self.weight_decay}.")

    def simulator_steps(self, rows: int, action_size: int) -> int:
        """Simulator steps of inverting `rows` transitions: the first, and in each iteration A differences and a try."""
        return rows * (1 + self.iterations * (action_size + 1))


_Search = tuple[Float[Array, "B A"], Float[Array, "B O"], Float[Array, " B"]]


class Inverted(flax.struct.PyTreeNode):
    """Actions that explain logged transitions.

    Attributes:
      observation: where it was taken.
      action: the logged action.
      explained: the simulator's action a~.
      misfit: what a~ leaves unexplained of s', root mean square in standard deviations of s' - s.
      weight: 1, or 0 for padding and where an observation does not tell its state.
    """

    observation: Float[Array, "*n B O"]
    action: Float[Array, "*n B A"]
    explained: Float[Array, "*n B A"]
    misfit: Float[Array, "*n B"]
    weight: Float[Array, "*n B"]


def invert(env: Env, log: TargetLog, config: InversionConfig) -> Inverted:
    """Finds the simulator's action for every transition of `log`; those whose state is not told weigh nothing.

    Raises:
      ValueError: an observation of `env` does not determine its state.
    """
    low, high = jnp.asarray(env.action_low), jnp.asarray(env.action_high)
    size = env.action_size
    flat = lambda x: x.reshape(-1, *x.shape[2:])  # noqa: E731
    valid = log.valid
    observation, action, target = (
        flat(jnp.where(valid[..., None], x, 0.0)) for x in (log.observation, log.action, log.next_observation)
    )
    weight = (flat(valid) & jax.vmap(env.tells_state)(observation)).astype(jnp.float32)
    change = target - observation
    total = jnp.sum(weight)
    mean = jnp.sum(change * weight[:, None], axis=0) / total
    scale = jnp.sqrt(jnp.sum(weight[:, None] * (change - mean[None]) ** 2, axis=0) / total) + 1e-6

    predict = jax.vmap(env.predict)

    def residual(act: Float[Array, "B A"]) -> Float[Array, "B O"]:
        return (predict(observation, act) - target) / scale[None]

    delta = config.difference * (high - low)

    def improve(carry: _Search, _: None) -> tuple[_Search, None]:
        act, error, damping = carry
        # A step that would leave the box is taken inwards.
        signed = jnp.where(act + delta[None] > high[None], -delta[None], delta[None])
        shifted = act[:, None, :] + signed[:, None, :] * jnp.eye(size)[None]
        moved = jax.vmap(residual, in_axes=1, out_axes=1)(shifted)
        jacobian = (moved - error[:, None, :]) / signed[:, :, None]
        normal = jnp.einsum("bio,bjo->bij", jacobian, jacobian)
        ridge = damping[:, None, None] * jnp.eye(size)[None]
        step = jnp.linalg.solve(normal + ridge, jnp.einsum("bio,bo->bi", jacobian, error)[..., None])[..., 0]
        proposal = jnp.clip(act - step, low[None], high[None])
        new_error = residual(proposal)
        better = jnp.sum(new_error**2, axis=1) < jnp.sum(error**2, axis=1)
        act = jnp.where(better[:, None], proposal, act)
        error = jnp.where(better[:, None], new_error, error)
        return (act, error, jnp.where(better, damping * 0.1, damping * 10.0)), None

    start = jnp.clip(action, low[None], high[None])
    # Curvature along an action that moves nothing is left to the ridge: such an action stays where it was.
    damping = jnp.full(start.shape[0], 1e-4)
    carry, _ = jax.lax.scan(improve, (start, residual(start), damping), None, config.iterations)
    explained, error, _ = carry
    misfit = jnp.sqrt(jnp.mean(error**2, axis=1))
    return Inverted(observation, action, explained, misfit, weight)


def regress(key: PRNGKeyArray, inverted: Inverted, config: InversionConfig) -> Transformer:
    """Fits the mean of a transformer to `explained - action`, on standardised inputs. `key` is consumed.

    Rows that no action explains count less: weight `1 / (1 + (misfit / median misfit)^2)`, with the median floored at
    0.01 standard deviations.
    """
    key_init, key_rows = jax.random.split(key)
    size, rows = inverted.action.shape[1], inverted.action.shape[0]
    pair = jnp.concatenate([inverted.observation, inverted.action], axis=1)
    total = jnp.sum(inverted.weight)
    mean = jnp.sum(pair * inverted.weight[:, None], axis=0) / total
    std = jnp.sqrt(jnp.sum((pair - mean[None]) ** 2 * inverted.weight[:, None], axis=0) / total)
    pi_g = transformer.init(key_init, inverted.observation.shape[1], size, config.transformer)
    pi_g = pi_g.replace(input_mean=mean, input_std=jnp.maximum(std, 1e-3))
    typical = jnp.nanmedian(jnp.where(inverted.weight > 0, inverted.misfit, jnp.nan))
    trust = inverted.weight / (1.0 + (inverted.misfit / jnp.maximum(typical, 0.01)) ** 2)
    # Where the simulator diverges, as it may from a padding row's state, there is no misfit.
    trust = jnp.where(jnp.isfinite(inverted.misfit), trust, 0.0)
    wanted = inverted.explained - inverted.action
    inputs = transformer.network_inputs(pi_g, inverted.observation, inverted.action)

    per_epoch = max(1, rows // config.minibatch_size)
    steps = config.epochs * per_epoch
    optimiser = optax.adamw(
        optax.cosine_decay_schedule(config.learning_rate, steps), weight_decay=config.weight_decay
    )

    def loss(params: Params, chosen: Int[Array, " M"]) -> Float[Array, ""]:
        mean, _ = transformer.apply(params, inputs[chosen])
        error = jnp.sum((mean - wanted[chosen]) ** 2, axis=1)
        return jnp.sum(trust[chosen] * error) / jnp.maximum(jnp.sum(trust[chosen]), 1e-6)

    def step(carry: tuple[Params, Any], key: PRNGKeyArray) -> tuple[tuple[Params, Any], None]:
        params, opt = carry
        chosen = jax.random.randint(key, (min(config.minibatch_size, rows),), 0, rows)
        updates, opt = optimiser.update(jax.grad(loss)(params, chosen), opt, params)
        # The spread of pi_g is not learned here.
        updates = {**updates, "log_std": jnp.zeros_like(updates["log_std"])}
        return (optax.apply_updates(params, updates), opt), None

    carry = (pi_g.params, optimiser.init(pi_g.params))
    (params, _), _ = jax.lax.scan(step, carry, jax.random.split(key_rows, steps))
    return pi_g.replace(params=params)
