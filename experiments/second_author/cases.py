"""The 30 cases: which machine, what is true beside its model, how it is moved and measured."""

from functools import partial

from experiments.second_author import arm_runs, arms, mover_runs, movers
from experiments.second_author.bodies import (
    ComOffset,
    ContactFriction,
    ContactStiffness,
    Drag,
    Payload,
    Slosh,
    Tilt,
)
from experiments.second_author.drives import (
    Crosstalk,
    Deadzone,
    Delay,
    EncoderOffset,
    Gain,
    GroundEffect,
    Lag,
    Saturation,
    SensorDelay,
)
from experiments.second_author.joints import (
    Armature,
    Backlash,
    Cogging,
    Coulomb,
    Dahl,
    Flexible,
    LoadFriction,
    Stiffness,
    Stribeck,
    Viscous,
)
from experiments.second_author.recording import Case, bits
from experiments.second_author.simulation import Effect

SERVOS = ("base_servo", "shoulder_servo", "elbow_servo", "wrist_servo")
SCARA = {"j1": bits(13, 2e-4), "j2": bits(13, 2e-4), "z": (1e-4, 5e-5), "roll": bits(12, 2e-4)}
CAD_SCARA = {"j1": bits(12, 3e-4), "j2": bits(12, 3e-4), "z": (2e-4, 1e-4), "roll": bits(12, 3e-4)}
FLYING = (0.02, 0.02, 0.02, 0.01, 0.01, 0.01)
LOW = partial(mover_runs.quadrotor, height=0.28, spans=(0.4, 0.4, 0.16))
NO_ROTORS = arms.scara(armature=(0, 0, 0, 0))
SMALL_ROTORS = arms.arm6(armature=(0.2, 0.2, 0.12, 0.03, 0.025, 0.015))


def every_joint(
    names: tuple[str, ...], inertia: tuple[float, ...], torque: tuple[float, ...]
) -> list[Effect]:
    """Rotor inertia and dry friction in each of the joints."""
    out: list[Effect] = [Armature(name, x) for name, x in zip(names, inertia, strict=True)]
    return out + [Coulomb(name, x) for name, x in zip(names, torque, strict=True)]


def every_servo(gains: tuple[float, ...], delays: tuple[float, ...]) -> list[Effect]:
    """Weak servos that are told late."""
    out: list[Effect] = [Gain(name, x) for name, x in zip(SERVOS, gains, strict=True)]
    return out + [Delay(name, x) for name, x in zip(SERVOS, delays, strict=True)]


CASES = (
    Case(
        1, "arm6", arms.arm6(), "null", lambda: [], arm_runs.arm6, ("sines", "moves"), 250, 0.0005, bits(14, 1e-4),
        note="truth in steps of 0.5 ms, nominal 2 ms",
    ),
    Case(
        2, "rover", movers.rover(), "null", lambda: [], mover_runs.rover, ("sines", "dashes"), 100, 0.002, bits(10),
        note="contact, motion capture at 100 Hz",
    ),
    Case(
        3, "furuta", movers.furuta(), "null", lambda: [], mover_runs.furuta, ("sines", "pulses"), 200, 0.00025,
        bits(12, 2e-4), jitter=2,
        note="Euler, truth in steps of 0.25 ms, rows of 5 ms that jitter by up to 0.5 ms (stamps are right)",
    ),
    Case(
        4, "desk_arm", arms.desk_arm(), "null", lambda: [], arm_runs.desk_arm, ("sines", "moves"), 50, 0.001,
        bits(12, 2e-4), note="12-bit encoders at 50 Hz",
    ),
    Case(
        5, "quadrotor", movers.quadrotor(), "null", lambda: [], mover_runs.quadrotor, ("sines", "moves"), 200, 0.001,
        velocity=FLYING, note="motion capture and velocities with noise",
    ),
    Case(
        6, "desk_arm", arms.desk_arm(), "single", lambda: [Saturation("shoulder_servo", 1.35)], arm_runs.desk_arm,
        ("sines", "steps"), 100, 0.0005, bits(12, 2e-4),
        note="a servo weaker than its data sheet in large steps only",
    ),
    Case(
        7, "scara", arms.scara(), "single", lambda: [Tilt(0.02, [0.6, 0.8, 0.0])], arm_runs.scara,
        ("pick_place", "sines"), 250, 0.0005, SCARA,
        note="base not level; gravity does nothing in j1 and j2, so an offset of j1's encoder is not the same",
    ),
    Case(
        8, "cart_pole", movers.cart_pole(), "single", lambda: [Coulomb("rail", 0.5)], mover_runs.cart_pole,
        ("sines", "steps"), 125, 0.0005, {"rail": (3e-4, 1e-4), "pivot": bits(12, 2e-4)},
    ),
    Case(
        9, "gantry", movers.gantry(), "single", lambda: [Drag("load", 0.09)], mover_runs.gantry, ("moves", "sines"),
        100, 0.001, {"x": (3e-4, 0), "y": (3e-4, 0), "sway_x": (4e-4, 5e-4), "sway_y": (4e-4, 5e-4)},
        note="air drag of a bulky load; like drag at both sways, but the trolley's motion counts too",
    ),
    Case(
        10, "furuta", movers.furuta(), "single", lambda: [Cogging("arm_joint", 0.004, 0.8, 7)], mover_runs.furuta,
        ("sines", "pulses"), 200, 0.0005, bits(12, 2e-4), note="7 poles",
    ),
    Case(
        11, "leg", arms.leg(), "single", lambda: [Flexible("knee", 55.0, 0.04)], arm_runs.leg, ("sines", "moves"),
        500, 0.00025, bits(13, 2e-4), motor_side=True,
        note="belt to the knee, recorded encoder at the link; the nominal armature is the motor's",
    ),
    Case(
        12, "rover", movers.rover(), "single", lambda: [ContactFriction(0.35)], mover_runs.rover,
        ("sines", "dashes"), 100, 0.001, bits(10),
        note="slippery floor, mu of floor and tyres both 0.35 (MuJoCo takes the greater of a pair; casters are "
        "frictionless by priority)",
    ),
    Case(
        13, "hopper", movers.hopper(), "single", lambda: [ContactStiffness(0.032)], mover_runs.hopper,
        ("other_hop", "other_squat"), 250, 0.0005,
        {"rail": (3e-4, 1e-4), "hip": bits(13, 3e-4), "knee": bits(13, 3e-4)},
        same_place={"contact_stiffness": ("foot", "plate")},
        note="soft mat under the foot; only two geoms touch, so world or one of them are alike up to the number",
    ),
    Case(
        14, "head", arms.pan_tilt(), "single", lambda: [Backlash("tilt", 0.04, 0.25, 4000.0, 0.002)], arm_runs.head,
        ("sines", "looks"), 250, 0.0001, bits(13, 2e-4), motor_side=True,
        note="recorded encoder at the camera; the nominal armature is the motor's",
    ),
    Case(
        15, "arm6", arms.arm6(), "single", lambda: [Payload("flange", 0.25, [0.06, 0.02, 0.0])], arm_runs.arm6,
        ("sines", "moves"), 200, 0.0005, bits(12, 3e-4), note="tool that the model lacks",
    ),
    Case(
        16, "five_bar", arms.five_bar(), "single", lambda: [LoadFriction("drive_l", "left_motor", 0.02, 0.12)],
        arm_runs.five_bar, ("sines", "moves"), 250, 0.0005, bits(12, 5e-4),
        note="left gear only; load is the motor's torque",
    ),
    Case(
        17, "pendulum", movers.pendulum(), "single", lambda: [Stribeck("shaft", 0.035, 0.075, 0.15)],
        mover_runs.pendulum, ("sines", "torque"), 200, 0.0005, bits(12, 3e-4),
        note="stick-slip in the slow runs; plain dry friction is the same but for speeds under 0.3 rad/s",
    ),
    Case(
        18, "balancer", movers.balancer(), "pair",
        lambda: [Deadzone("wheel_motor", 0.008), ComOffset("body", [0.0015, 0, 0])], mover_runs.balancer,
        ("sines", "drive"), 200, 0.001,
        {"x": (5e-4, 0), "z": (5e-4, 0), "pitch": (1.5e-3, 0), "wheel": bits(9)}, smooth=0.6, plane=(0,),
        twins={"com_offset": (("encoder_offset", "pitch"),)},
        note="the offset along x alone is seen; an offset of the pitch sensor (0.014 rad) is about the same; dead zone "
        "and dry friction at the wheel differ only when braking",
    ),
    Case(
        19, "quadrotor", movers.quadrotor(), "pair", lambda: [Gain("rotor3", 0.95), Drag("frame", 0.2)],
        mover_runs.quadrotor, ("sines", "moves"), 200, 0.001, velocity=FLYING,
        note="worn propeller; drag at the centre of mass",
    ),
    Case(
        20, "gripper", arms.gripper(), "pair", lambda: [Coulomb("slide_l", 1.6), Stiffness("pitch", 2.0, 0.35)],
        arm_runs.gripper, ("sines", "moves"), 100, 0.0005,
        {"pitch": bits(12, 2e-4), "roll": bits(12, 2e-4), "slide_l": (2e-5, 2e-5), "slide_r": (2e-5, 2e-5)},
        same_place={"coulomb_friction": ("slide_r",)},
        note="the fingers are geared 1:1: friction at one and at the other cannot be told apart; a cable at pitch",
    ),
    Case(
        21, "scara", arms.scara(), "pair",
        lambda: [SensorDelay("j2", 0.006), Payload("quill", 0.12, [0.0, 0.0, -0.1])], arm_runs.scara,
        ("pick_place", "sines"), 250, 0.0005, SCARA, plane=(0, 1), same_place={"payload_mass": ("tool",)},
        note="the height of the mass is not observable; on the axis of roll it may as well sit on the tool",
    ),
    Case(
        22, "desk_arm", arms.desk_arm(), "triple",
        lambda: [Delay("base_servo", 0.03), Payload("hand", 0.09, [0.05, 0.0, 0.0]), Coulomb("shoulder", 0.2)],
        arm_runs.desk_arm, ("sines", "moves"), 100, 0.0005, bits(12, 2e-4),
    ),
    Case(
        23, "arm6", arms.arm6(), "triple",
        lambda: [EncoderOffset("j3", 0.025), Lag("t2", 0.012), Viscous("j5", 0.3)], arm_runs.arm6,
        ("sines", "moves"), 250, 0.0005, bits(13, 2e-4), twins={"viscous_damping": (("back_emf", "t5"),)},
        note="viscous damping at j5 is the same as back-EMF of t5 (plain motor, no measured force)",
    ),
    Case(
        24, "arm6", SMALL_ROTORS, "whole",
        lambda: every_joint(
            ("j1", "j2", "j3", "j4", "j5", "j6"),
            (0.16, 0.2, 0.1, 0.02, 0.018, 0.01),
            (0.9, 1.2, 0.7, 0.15, 0.12, 0.07),
        ),
        arm_runs.arm6, ("sines", "moves"), 200, 0.0005, bits(12, 3e-4),
        note="rotor inertia too small and no dry friction; at j6 both are close to a smaller gain of t6",
    ),
    Case(
        25, "scara", NO_ROTORS, "whole",
        lambda: every_joint(("j1", "j2", "z", "roll"), (0.05, 0.02, 0.3, 0.0004), (0.3, 0.15, 1.5, 0.006)),
        arm_runs.scara, ("pick_place", "sines"), 250, 0.0005, CAD_SCARA,
        note="a CAD model without rotor inertia and dry friction; at roll both are nearly a smaller gain of mr",
    ),
    Case(
        26, "desk_arm", arms.desk_arm(), "whole",
        lambda: every_servo((0.78, 0.85, 0.8, 0.75), (0.025, 0.02, 0.03, 0.015)), arm_runs.desk_arm,
        ("sines", "moves"), 100, 0.0005, bits(12, 2e-4),
        note="flat battery and a slow bus; 15 ms of delay are common to all; at the base a smaller gain is nearly more "
        "inertia and damping",
    ),
    Case(
        27, "tank", movers.tank_stage(), "unknown", lambda: [Slosh("tip", "tank", 0.14, 2.1, 0.03)],
        mover_runs.tank_stage, ("moves", "sines"), 200, 0.0005,
        {"x": (1e-4, 1e-4), "z": (1e-4, 1e-4), "tip": bits(12, 4e-4)}, also_at=("x",),
        note="0.21 kg of liquid swings at 2.1 Hz along x; mass and centre at rest are the model's; at tip and at x",
    ),
    Case(
        28, "leg", arms.leg(), "unknown", lambda: [Crosstalk("knee_m", "hip_m", 0.04)], arm_runs.leg,
        ("sines", "moves"), 500, 0.0005, bits(12, 3e-4), note="knee torque: its own and 0.04 times the hip's command",
    ),
    Case(
        29, "head", arms.pan_tilt(), "mixed", lambda: [Viscous("tilt", 0.012), Dahl("pan", 0.05, 0.25)], arm_runs.head,
        ("sines", "looks"), 200, 0.0005, bits(12, 4e-4), twins={"viscous_damping": (("back_emf", "tilt_motor"),)},
        note="a spring or dry friction explains parts of what acts at pan",
    ),
    Case(
        30, "quadrotor", movers.quadrotor(), "mixed",
        lambda: [GroundEffect("frame", 0.024), Payload("frame", 0.03, [0.05, 0.0, -0.02])], LOW, ("sines", "moves"),
        200, 0.001, velocity=FLYING,
        note="thrust grows near the floor at z = 0, by 0.2 to 19 % at the heights flown, beside a small payload",
    ),
)  # fmt: skip
