"""Backlash and flexibility: the motor becomes a body of its own, joined to the link by a torque computed here.

The nominal armature is the motor's inertia; damping, limits and the recorded position stay with the link.
"""

import math

import mujoco
import numpy as np

from experiments.blind.truth.plant import Plant
from experiments.blind.truth.stages import Stages
from experiments.blind.vocabulary import Effect

CONTACT_FREQUENCY = 900.0  # rad/s of the rotor against a closed gap: 20 times faster than any motion here
CONTACT_DAMPING = 0.3  # of the critical value


def _add_rotor(joint_name: str, stages: Stages[Plant]) -> str:
    """A rotor beside the link, on the same axis; the actuator moves to it. Returns the rotor's joint name."""
    rotor_name = f"rotor of {joint_name}"

    def edit(spec: mujoco.MjSpec) -> None:
        joint = spec.joint(joint_name)
        body = joint.parent
        if joint.armature <= 0:
            raise ValueError(f"joint {joint_name!r} needs a nominal armature: it is the motor's inertia")
        rotor = body.parent.add_body(name=rotor_name, pos=body.pos, quat=body.quat)
        rotor.mass, rotor.ipos, rotor.inertia = 1e-7, [0, 0, 0], [1e-9] * 3
        rotor.explicitinertial = True
        motor = rotor.add_joint(name=rotor_name, type=joint.type, axis=joint.axis, pos=joint.pos)
        motor.armature = joint.armature
        # The model's default class applies to new joints as well: all that is not the rotor's stays with the link.
        motor.damping, motor.stiffness, motor.frictionloss = [0] * 3, [0] * 3, 0
        motor.limited = motor.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.armature = 0

    stages.spec.append(edit)
    stages.drive_joint[joint_name] = rotor_name
    return rotor_name


def _join(joint: str, rotor: str, stages: Stages[Plant], torque) -> None:
    def add(plant: Plant, extra: np.ndarray) -> None:
        t = torque(plant, plant.q(rotor) - plant.q(joint), plant.v(rotor) - plant.v(joint))
        extra[plant.dof(joint)] += t
        extra[plant.dof(rotor)] -= t

    stages.joint.append(add)


def joint_flexibility(effect: Effect, stages: Stages[Plant]) -> None:
    """Spring-damper between motor and link."""
    k, c = effect.number("stiffness"), effect.number("damping")
    rotor = _add_rotor(effect.at, stages)
    _join(effect.at, rotor, stages, lambda plant, twist, rate: k * twist + c * rate)


def backlash(effect: Effect, stages: Stages[Plant]) -> None:
    """No torque while the motor is within +-gap/2 of the link, a stiff contact beyond (which never pulls)."""
    half = effect.number("gap") / 2
    rotor = _add_rotor(effect.at, stages)

    def torque(plant: Plant, twist: float, rate: float) -> float:
        depth = abs(twist) - half
        if depth <= 0:
            return 0.0
        side, inertia = math.copysign(1.0, twist), float(plant.model.dof_armature[plant.dof(rotor)])
        stiffness = inertia * CONTACT_FREQUENCY**2
        damping = 2 * CONTACT_DAMPING * inertia * CONTACT_FREQUENCY
        return side * max(stiffness * depth + damping * side * rate, 0.0)

    _join(effect.at, rotor, stages, torque)
