"""The vocabulary: every effect that the diagnosis knows, by identifier."""

from mpge_jax.diagnosis.effects import actuator, elastic, friction, inertia, sensor, world
from mpge_jax.diagnosis.effects.base import (
    REGISTRY,
    Context,
    Effect,
    Fields,
    Forces,
    Param,
    Place,
    Step,
    find_place,
    nominal_context,
    register,
)

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
    "elastic",
    "find_place",
    "friction",
    "inertia",
    "nominal_context",
    "register",
    "sensor",
    "world",
]
