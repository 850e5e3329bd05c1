"""The vocabulary: every effect that the diagnosis knows, by identifier."""

from mpge_jax.diagnosis.effects import (
    actuator,
    actuator_command,
    angle,
    drive,
    friction,
    inertia,
    residual,
    sensor,
    soft_limit,
    world,
)
from mpge_jax.diagnosis.effects.base import REGISTRY, Effect, find_place, register
from mpge_jax.diagnosis.effects.context import Context, Param, Place, nominal_context
from mpge_jax.diagnosis.effects.step import Fields, Forces, Step

VOCABULARY = (
    "viscous_damping", "coulomb_friction", "stribeck_friction", "load_dependent_friction",
    "asymmetric_friction", "quadratic_drag", "joint_stiffness", "cogging_torque", "backlash",
    "joint_flexibility", "armature", "actuator_gain", "dead_actuator", "actuator_bias", "torque_saturation",
    "actuator_deadzone", "actuator_delay", "actuator_lag", "back_emf", "payload_mass", "mass_scale",
    "com_offset", "gravity_tilt", "external_force", "contact_friction", "contact_stiffness",
    "encoder_offset", "sensor_delay",
)  # fmt: skip
"""The identifiers that reports, tests and benchmarks use."""

__all__ = [
    "REGISTRY",
    "VOCABULARY",
    "Context",
    "Effect",
    "Fields",
    "Forces",
    "Param",
    "Place",
    "Step",
    "actuator",
    "actuator_command",
    "angle",
    "drive",
    "find_place",
    "friction",
    "inertia",
    "nominal_context",
    "register",
    "residual",
    "sensor",
    "soft_limit",
    "world",
]
