"""What a machine of the benchmark is: a nominal model, a way to run it, and places for hidden physics."""

from dataclasses import dataclass, field
from pathlib import Path

import gymnasium
import mujoco

HERE = Path(__file__).parent / "mjcf"
ASSETS = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"

Places = dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class Robot:
    """One machine and how it is run.

    periods: recording (and control) periods [s]; references: (centre, span) of each reference signal;
    top: highest reference frequency [Hz]; steps: (dt, integrator) of the true machine; plane: components of vectors
    in the world that can be observed (0 and 2 in a vertical plane); xml: the model itself, of one without a file.
    """

    name: str
    file: Path | None
    controller: str
    references: tuple[tuple[float, float], ...]
    places: Places
    bandwidth: float = 7.0
    top: float = 1.6
    periods: tuple[float, ...] = (0.004, 0.005, 0.01)
    steps: tuple[tuple[float, str], ...] = ((0.0005, "implicitfast"), (0.00025, "Euler"))
    plane: tuple[int, ...] = (0, 2)
    open_loop: bool = False
    start: dict[str, float] = field(default_factory=dict)
    duration: tuple[float, float] = (4.0, 6.0)
    xml: str = ""

    def spec(self) -> mujoco.MjSpec:
        """The nominal model, standalone; gymnasium's cheetah gets its total mass by geom densities."""
        if self.file is None:
            return mujoco.MjSpec.from_string(self.xml)
        spec = mujoco.MjSpec.from_file(str(self.file))
        total = spec.compiler.settotalmass
        if total > 0:
            spec.compiler.settotalmass = -1
            share = total / float(spec.compile().body_mass.sum())
            for geom in spec.geoms:
                geom.density *= share
        return spec


DRIVE: tuple[str, ...] = (
    "viscous_damping",
    "coulomb_friction",
    "stribeck_friction",
    "load_dependent_friction",
)
DRIVE += ("asymmetric_friction", "quadratic_drag", "joint_stiffness", "cogging_torque", "armature")
MOTOR: tuple[str, ...] = (
    "actuator_gain",
    "dead_actuator",
    "actuator_bias",
    "torque_saturation",
    "actuator_deadzone",
)
MOTOR += ("actuator_delay", "actuator_lag")
UNKNOWN_JOINT = ("periodic_kick", "hysteresis_spring", "speed_gravity", "rough_spot", "position_damping")
UNKNOWN_MOTOR = ("gain_drift", "dropout")


def places_of(driven: tuple[str, ...], motors: tuple[str, ...], **more: tuple[str, ...]) -> Places:
    """Joint effects on driven joints, actuator effects on motors, and `more` (an empty tuple takes one away)."""
    table: Places = {effect: driven for effect in DRIVE + UNKNOWN_JOINT}
    table |= {effect: motors for effect in MOTOR + UNKNOWN_MOTOR}
    table |= more
    return {effect: where for effect, where in table.items() if where}
