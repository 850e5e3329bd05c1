"""Machines generated at random: trees of 1 to 7 driven joints, none like another."""

import mujoco
import numpy as np

from experiments.blind.robots.robot import Places, Robot, places_of

MOST_JOINTS = 7
BRANCH = 0.25  # chance that a link hangs on another than the last one
RESERVE = 3.0  # torque of a motor over what holds all beyond it stretched out


def random_tree(rng: np.random.Generator, joints: int | None = None) -> Robot:
    """An arm of `joints` (drawn: 1 to 7) hinges with motors, links and axes drawn at random, perhaps branching.

    Raises:
        ValueError: a number of joints that is not 1 to 7.
    """
    joints = int(rng.integers(1, MOST_JOINTS + 1)) if joints is None else joints
    if not 1 <= joints <= MOST_JOINTS:
        raise ValueError(f"a tree has 1 to {MOST_JOINTS} joints, not {joints}")
    spec = mujoco.MjSpec()
    spec.modelname = f"tree{joints}"
    spec.compiler.degree = False
    spec.option.timestep = float(rng.choice([0.001, 0.002]))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    bodies, ends = [spec.worldbody], [np.array([0.0, 0.0, 1.0])]
    reach, references = float(np.exp(rng.uniform(np.log(0.1), np.log(0.5)))), []
    for i in range(joints):
        parent = len(bodies) - 1 if i == 0 or rng.random() > BRANCH else int(rng.integers(1, len(bodies)))
        link = _link(rng, bodies[parent], ends[parent], i, reach * 0.85**i)
        bodies.append(link[0])
        ends.append(link[1])
        references.append((float(rng.uniform(-0.5, 0.5)), float(rng.uniform(0.5, 1.3))))
    model = spec.compile()
    for i in range(joints):
        # the weight of all beyond, a link and a half away
        hold = model.body_subtreemass[i + 1] * 9.81 * reach * 1.5
        motor = spec.add_actuator(name=f"motor_{i}", target=f"joint_{i}")
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.gear[0] = float(round(hold, 3))
        motor.ctrllimited, motor.ctrlrange = mujoco.mjtLimited.mjLIMITED_TRUE, [-RESERVE, RESERVE]
    spec.compile()
    return Robot(
        spec.modelname,
        None,
        "torque",
        tuple(references),
        _places(model),
        xml=spec.to_xml(),
        plane=(0, 1, 2) if joints > 1 else (0, 2),
        steps=((0.0005, "implicitfast"), (0.00025, "Euler")),
    )


def _link(
    rng: np.random.Generator, parent: mujoco.MjsBody, at: np.ndarray, number: int, length: float
) -> tuple[mujoco.MjsBody, np.ndarray]:
    """A link on a hinge at `at` of its parent; returns it and the point where its own children hang."""
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    # an axis along the link would turn next to nothing, and a first one along gravity feels none
    axis = np.cross(direction, rng.standard_normal(3)) if number else np.array([0.0, 1.0, 0.0])
    if not number:
        direction[1] = 0.3 * direction[1]
        direction /= np.linalg.norm(direction)
    axis /= np.linalg.norm(axis)
    end = length * direction
    body = parent.add_body(name=f"link_{number}", pos=at.tolist())
    mass = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0)))) * (length / 0.3) ** 2 + 0.05
    body.add_geom(
        name=f"rod_{number}",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0.0, 0.0, 0.0, *end.round(4)],
        size=[round(0.1 * length, 4), 0, 0],
        mass=round(mass, 4),
        contype=0,
        conaffinity=0,
    )
    inertia = mass * length**2 / 3
    body.add_joint(
        name=f"joint_{number}",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=axis.round(4).tolist(),
        armature=round(float(rng.uniform(0.1, 0.5)) * inertia, 6),
        damping=round(float(rng.uniform(0.2, 1.0)) * inertia, 6),
    )
    return body, end


def _places(model: mujoco.MjModel) -> Places:
    joints = tuple(model.joint(j).name for j in range(model.njnt))
    motors = tuple(model.actuator(i).name for i in range(model.nu))
    if model.njnt == 1:
        return places_of(joints, motors, dead_actuator=(), sensor_delay=joints)
    tips = tuple(model.body(b).name for b in range(1, model.nbody) if b not in model.body_parentid[1:])
    return places_of(
        joints,
        motors,
        joint_flexibility=joints,
        backlash=joints,
        payload_mass=tips,
        com_offset=tips,
        mass_scale=("world",),
        gravity_tilt=("world",),
        external_force=tips,
        encoder_offset=joints[1:],
        sensor_delay=joints,
        cross_coupling=joints,
    )
