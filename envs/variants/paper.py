"""The paper's four targets (section 5.1; paper-text torso mass of HeavyCheetah read as total mass, as released)."""

import jax
import jax.numpy as jnp

from envs.types import Variant


def skew(action: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """A constant force of +1.5 on top of every command, clipped to the actuator's range."""
    return jnp.clip(action + 1.5, low, high)


def break_first(action: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """Actuator 0 gives no torque (back thigh of HalfCheetah, thigh of Hopper)."""
    del low, high
    return action.at[0].set(0.0)


PAPER = (
    Variant(
        "SkewedPendulum", "InvertedPendulum", "+1.5 on the cart's command, then clipped to +-3", action=skew
    ),
    Variant("BrokenHopper", "Hopper", "the thigh's motor is dead", action=break_first),
    Variant("BrokenCheetah", "HalfCheetah", "the back thigh's motor is dead", action=break_first),
    Variant("HeavyCheetah", "HalfCheetah", "total mass 20 kg in place of 14 kg", total_mass=20.0),
)
