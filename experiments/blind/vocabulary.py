"""The effects by name: what each is called, what its parameters are called, and where it can act."""

from dataclasses import dataclass, field

#: Parameter names of every effect, as the diagnosis has to report them.
PARAMETERS: dict[str, tuple[str, ...]] = {
    "viscous_damping": ("coefficient",),
    "coulomb_friction": ("torque",),
    "stribeck_friction": ("coulomb", "static", "velocity"),
    "load_dependent_friction": ("coulomb", "load_coefficient"),
    "asymmetric_friction": ("coulomb_forward", "coulomb_backward", "viscous_forward", "viscous_backward"),
    "quadratic_drag": ("coefficient",),
    "joint_stiffness": ("stiffness", "reference"),
    "cogging_torque": ("amplitude", "periods", "phase"),
    "backlash": ("gap",),
    "joint_flexibility": ("stiffness", "damping"),
    "armature": ("inertia",),
    "actuator_gain": ("gain",),
    "dead_actuator": (),
    "actuator_bias": ("bias",),
    "torque_saturation": ("limit",),
    "actuator_deadzone": ("width",),
    "actuator_delay": ("delay",),
    "actuator_lag": ("time_constant",),
    "back_emf": ("coefficient",),
    "payload_mass": ("mass", "position"),
    "mass_scale": ("factor",),
    "com_offset": ("offset",),
    "gravity_tilt": ("angle", "axis"),
    "external_force": ("force",),
    "contact_friction": ("mu",),
    "contact_stiffness": ("time_constant",),
    "encoder_offset": ("offset",),
    "sensor_delay": ("delay",),
}

DRY_FRICTION = ("coulomb_friction", "stribeck_friction", "load_dependent_friction", "asymmetric_friction")
#: Effects on the scalar actuator force; two of them on one actuator would depend on their order.
ACTUATOR = (
    "actuator_gain",
    "dead_actuator",
    "actuator_bias",
    "torque_saturation",
    "actuator_deadzone",
    "actuator_delay",
    "actuator_lag",
    "back_emf",
)
SENSOR = ("encoder_offset", "sensor_delay")
TRANSMISSION = ("backlash", "joint_flexibility")


@dataclass(frozen=True)
class Effect:
    """One hidden effect: identifier, MJCF name of the place, parameters in SI units (vectors as lists).

    Raises ValueError for an unknown identifier or parameter names that do not belong to it, unless it is
    `unknown`: an effect outside the vocabulary.
    """

    id: str
    at: str
    parameters: dict[str, float | list[float]] = field(default_factory=dict)
    unknown: bool = False

    def __post_init__(self) -> None:
        if self.unknown:
            return
        if self.id not in PARAMETERS:
            raise ValueError(f"unknown effect {self.id!r}; the vocabulary has {', '.join(PARAMETERS)}")
        if set(self.parameters) != set(PARAMETERS[self.id]):
            raise ValueError(f"{self.id} takes {PARAMETERS[self.id]}, got {tuple(self.parameters)}")

    def number(self, name: str) -> float:
        """A scalar parameter."""
        value = self.parameters[name]
        if isinstance(value, list):
            raise ValueError(f"{self.id}.{name} is a vector, not a number")
        return value

    def vector(self, name: str) -> list[float]:
        """A vector parameter."""
        value = self.parameters[name]
        if not isinstance(value, list):
            raise ValueError(f"{self.id}.{name} is a number, not a vector")
        return value

    def as_json(self) -> dict:
        """What goes into an answer file."""
        return {"id": self.id, "at": self.at, "parameters": self.parameters}
