"""The machines: nine MJCF files beside this module and the paper's three, taken from the installed gymnasium.

Every machine says where each effect may be drawn. Places where an effect is identical in principle to another one at
the same place (a payload on a cart and its rotor inertia, say) are left out or listed as twins in `equivalence.py`.
"""

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
    in the world that can be observed (0 and 2 in a vertical plane).
    """

    name: str
    file: Path
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

    def spec(self) -> mujoco.MjSpec:
        """The nominal model, standalone; gymnasium's cheetah gets its total mass by geom densities."""
        spec = mujoco.MjSpec.from_file(str(self.file))
        total = spec.compiler.settotalmass
        if total > 0:
            spec.compiler.settotalmass = -1
            share = total / float(spec.compile().body_mass.sum())
            for geom in spec.geoms:
                geom.density *= share
        return spec


DRIVE = ("viscous_damping", "coulomb_friction", "stribeck_friction", "load_dependent_friction")
DRIVE += ("asymmetric_friction", "quadratic_drag", "joint_stiffness", "cogging_torque", "armature")
MOTOR = ("actuator_gain", "dead_actuator", "actuator_bias", "torque_saturation", "actuator_deadzone")
MOTOR += ("actuator_delay", "actuator_lag")
UNKNOWN_JOINT = ("periodic_kick", "hysteresis_spring", "speed_gravity", "rough_spot", "position_damping")
UNKNOWN_MOTOR = ("gain_drift", "dropout")


def _places(driven: tuple[str, ...], motors: tuple[str, ...], **more: tuple[str, ...]) -> Places:
    """Joint effects on driven joints, actuator effects on motors, and `more` (an empty tuple takes one away)."""
    table: Places = {effect: driven for effect in DRIVE + UNKNOWN_JOINT}
    table |= {effect: motors for effect in MOTOR + UNKNOWN_MOTOR}
    table |= more
    return {effect: where for effect, where in table.items() if where}


ROBOTS: dict[str, Robot] = {
    robot.name: robot
    for robot in (
        Robot(
            "pendulum",
            HERE / "pendulum.xml",
            "torque",
            ((0.0, 2.4),),
            _places(
                ("pivot",),
                ("drive",),
                back_emf=("drive",),
                joint_flexibility=("pivot",),
                backlash=("pivot",),
                dead_actuator=(),
                sensor_delay=("pivot",),
            ),
            open_loop=True,
        ),
        Robot(
            "twolink",
            HERE / "twolink.xml",
            "torque",
            ((0.0, 1.8), (0.0, 1.6)),
            _places(
                ("shoulder", "elbow"),
                ("shoulder_motor", "elbow_motor"),
                back_emf=("shoulder_motor", "elbow_motor"),
                backlash=("shoulder", "elbow"),
                joint_flexibility=("shoulder", "elbow"),
                payload_mass=("fore",),
                com_offset=("upper", "fore"),
                mass_scale=("world",),
                gravity_tilt=("world",),
                external_force=("fore",),
                encoder_offset=("shoulder", "elbow", "elbow", "elbow"),
                sensor_delay=("shoulder", "elbow"),
                cross_coupling=("shoulder", "elbow"),
            ),
            open_loop=True,
        ),
        Robot(
            "geared_arm",
            HERE / "geared_arm.xml",
            "torque",
            ((0.0, 1.5), (0.2, 0.8), (0.8, 1.0)),
            _places(
                ("waist", "lift", "reach"),
                ("waist_drive", "lift_drive", "reach_drive"),
                backlash=("waist", "lift", "reach"),
                joint_flexibility=("waist", "lift", "reach"),
                payload_mass=("stick",),
                com_offset=("boom", "stick"),
                mass_scale=("world",),
                gravity_tilt=("world",),
                external_force=("stick",),
                encoder_offset=("lift", "reach"),
                sensor_delay=("lift", "reach"),
                cross_coupling=("lift", "reach"),
            ),
            plane=(0, 1, 2),
        ),
        Robot(
            "arm6",
            HERE / "arm6.xml",
            "torque",
            ((0.0, 1.2), (0.3, 0.7), (0.9, 0.8), (0.2, 0.9), (0.0, 1.2), (0.0, 1.2)),
            _places(
                ("j1", "j2", "j3", "j4", "j5", "j6"),
                ("m1", "m2", "m3", "m4", "m5", "m6"),
                back_emf=("m2", "m3", "m4"),
                backlash=("j2", "j3"),
                joint_flexibility=("j1", "j2", "j3"),
                payload_mass=("wrist2", "tool"),
                com_offset=("forearm", "upper_arm"),
                mass_scale=("world",),
                gravity_tilt=("world",),
                external_force=("tool", "forearm"),
                encoder_offset=("j2", "j3", "j4"),
                sensor_delay=("j2", "j3"),
                cross_coupling=("j2", "j3"),
            ),
            plane=(0, 1, 2),
            steps=((0.001, "implicitfast"), (0.001, "Euler")),
        ),
        Robot(
            "servo_arm",
            HERE / "servo_arm.xml",
            "servo",
            ((0.0, 1.6), (-0.2, 0.9), (0.4, 1.2), (0.0, 1.4)),
            _places(
                ("pan", "tilt", "bend", "roll"),
                ("pan_servo", "tilt_servo", "bend_servo"),
                payload_mass=("gripper", "hand"),
                com_offset=("arm", "hand"),
                mass_scale=("world",),
                gravity_tilt=("world",),
                external_force=("hand", "gripper"),
                encoder_offset=("tilt", "bend"),
                sensor_delay=("tilt", "bend"),
                cross_coupling=("tilt", "bend"),
            ),
            plane=(0, 1, 2),
            steps=((0.001, "implicitfast"), (0.001, "Euler")),
        ),
        Robot(
            "crane",
            HERE / "crane.xml",
            "cart",
            ((0.0, 0.6),),
            _places(
                ("rail", "swing"),
                ("winch",),
                dead_actuator=(),
                armature=("rail",),
                load_dependent_friction=("rail",),
                cogging_torque=("rail",),
                quadratic_drag=("rail", "hook"),
                payload_mass=("hook",),
                com_offset=("rod", "hook"),
                mass_scale=("world",),
                gravity_tilt=("world",),
                external_force=("hook", "rod"),
                encoder_offset=("swing", "dangle"),
                sensor_delay=("swing",),
                cross_coupling=("rail",),
            ),
            bandwidth=10.0,
            top=0.6,
            open_loop=True,
        ),
        Robot(
            "drone",
            HERE / "drone.xml",
            "drone",
            ((0.0, 1.2), (0.0, 0.8)),
            _places(
                ("sling",),
                ("front_rotor", "rear_rotor"),
                dead_actuator=(),
                load_dependent_friction=(),
                armature=(),
                actuator_deadzone=(),
                cogging_torque=(),
                quadratic_drag=("frame", "load"),
                payload_mass=("frame", "load"),
                com_offset=("frame", "load"),
                mass_scale=("world",),
                gravity_tilt=("world",),
                external_force=("frame", "load"),
                encoder_offset=("pitch", "sling"),
                viscous_damping=("x", "z", "sling"),
                sensor_delay=("pitch",),
            ),
            bandwidth=2.5,
            top=0.8,
        ),
        Robot(
            "boom_leg",
            HERE / "boom_leg.xml",
            "joints",
            ((-0.55, 0.35), (1.1, 0.6)),
            _places(
                ("hip", "knee"),
                ("hip_motor", "knee_motor"),
                dead_actuator=(),
                viscous_damping=("rail_z", "knee"),
                payload_mass=("trunk",),
                contact_friction=("world",),
                contact_stiffness=("world",),
                mass_scale=("world",),
                external_force=("trunk",),
                encoder_offset=("hip", "knee"),
                sensor_delay=("knee",),
            ),
            bandwidth=70.0,
            top=2.2,
            steps=((0.001, "Euler"),),
            start={"rail_z": -0.06, "hip": -0.55, "knee": 1.1},
        ),
        Robot(
            "block",
            HERE / "block.xml",
            "push",
            ((0.0, 0.5), (0.0, 0.4), (0.1, 0.85), (0.0, 0.6)),
            _places(
                (),
                ("push_x", "push_y"),
                actuator_bias=(),
                actuator_deadzone=("push_x", "lift"),
                actuator_gain=("push_x", "push_y", "lift"),
                quadratic_drag=("block",),
                contact_friction=("world",),
            ),
            bandwidth=6.0,
            top=1.0,
            steps=((0.001, "implicitfast"),),
            plane=(0, 1, 2),
        ),
        Robot(
            "inverted_pendulum",
            ASSETS / "inverted_pendulum.xml",
            "cart",
            ((0.0, 0.3),),
            _places(
                ("slider", "hinge"),
                ("slide",),
                dead_actuator=(),
                armature=("slider",),
                load_dependent_friction=("slider",),
                quadratic_drag=("slider",),
                joint_stiffness=("slider",),
                cogging_torque=(),
                stribeck_friction=(),
                mass_scale=("world",),
                gravity_tilt=("world",),
                payload_mass=("pole",),
                encoder_offset=("hinge",),
                sensor_delay=("hinge",),
            ),
            bandwidth=3.0,
            top=0.5,
            periods=(0.02,),
            steps=((0.001, "implicitfast"),),
            duration=(5.0, 8.0),
            start={"hinge": 0.05},
        ),
        Robot(
            "hopper",
            ASSETS / "hopper.xml",
            "joints",
            ((-0.35, 0.3), (-0.6, 0.4), (0.1, 0.4)),
            _places(
                ("thigh_joint", "leg_joint", "foot_joint"),
                ("thigh_joint", "leg_joint", "foot_joint"),
                cogging_torque=(),
                backlash=(),
                stribeck_friction=(),
                contact_friction=("world",),
                mass_scale=("world",),
                payload_mass=("torso",),
                com_offset=("torso",),
                contact_stiffness=("world",),
            ),
            bandwidth=20.0,
            top=1.5,
            periods=(0.008, 0.004),
            steps=((0.001, "implicitfast"),),
        ),
        Robot(
            "half_cheetah",
            ASSETS / "half_cheetah.xml",
            "joints",
            ((0.1, 0.4), (0.0, 0.4), (0.1, 0.4), (-0.1, 0.4), (-0.1, 0.4), (0.0, 0.35)),
            _places(
                ("bthigh", "fthigh", "bshin"),
                ("bthigh", "fthigh", "bshin"),
                cogging_torque=(),
                mass_scale=("world",),
                payload_mass=("torso",),
                com_offset=("torso",),
                stribeck_friction=(),
                contact_friction=("world",),
                back_emf=("bthigh", "fthigh"),
            ),
            bandwidth=60.0,
            top=2.0,
            periods=(0.01,),
            steps=((0.01, "Euler"),),
        ),
    )
}
