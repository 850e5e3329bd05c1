"""Effects that are identical in principle on the data of a case, and how the contract wants them answered."""

from dataclasses import dataclass

import mujoco

from experiments.blind.robots.robot import Robot
from experiments.blind.vocabulary import Effect

PARALLEL_AXES = ("pendulum", "twolink")  # fixed base, every joint axis parallel
GROUND = {"boom_leg": ("foot", "floor"), "block": ("box", "floor")}  # the only pair of geoms that touch


@dataclass(frozen=True)
class Twins:
    """`twins`: (id, at) identical in principle to the truth. `coin`: the contract asks for `ambiguous`, so that
    naming one of them alone is a guess. `same`: other names of the very same place."""

    twins: tuple[tuple[str, str], ...] = ()
    coin: bool = False
    same: tuple[str, ...] = ()


def twins_of(robot: Robot, model: mujoco.MjModel, effect: Effect, with_force: bool) -> Twins:
    """What cannot be told from `effect` on this machine, with or without a recorded actuator force."""
    if effect.id == "back_emf" and not with_force:
        return Twins((("viscous_damping", _joint_of(model, effect.at)),), coin=True)
    if effect.id == "viscous_damping" and not with_force:
        return Twins(tuple(("back_emf", a) for a in _actuators_of(model, effect.at)))
    if robot.name in PARALLEL_AXES:
        root = model.joint(0).name
        if effect.id == "gravity_tilt":
            return Twins((("encoder_offset", root),), coin=True)
        if effect.id == "encoder_offset" and effect.at == root:
            return Twins((("gravity_tilt", "world"),), coin=True)
    if effect.id == "quadratic_drag" and effect.at in _joint_names(model) and _is_first(model, effect.at):
        return Twins((("quadratic_drag", _body_of(model, effect.at)),))
    if effect.id == "actuator_bias" and not with_force and _drives_slide(model, effect.at):
        return Twins((("external_force", _body_of(model, _joint_of(model, effect.at))),))
    if effect.id == "armature" and int(model.joint(effect.at).type[0]) == int(mujoco.mjtJoint.mjJNT_SLIDE):
        return Twins((("payload_mass", _body_of(model, effect.at)),))
    if model.nv == 1 and not with_force:
        if effect.id == "actuator_delay":
            return Twins((("sensor_delay", model.joint(0).name),), coin=True)
        if effect.id == "sensor_delay":
            return Twins((("actuator_delay", _actuators_of(model, effect.at)[0]),), coin=True)
    if effect.id == "contact_friction" and robot.name in GROUND:
        return Twins(same=GROUND[robot.name])
    if effect.id == "contact_stiffness" and robot.name in GROUND:
        return Twins(same=GROUND[robot.name])
    return Twins()


def drive_train(model: mujoco.MjModel, at: str) -> set[str]:
    """Names that mean the same drive as `at`: the joint, the body that it moves, the actuators on it."""
    names = {at}
    if at in _joint_names(model):
        joints = [at]
    elif at in actuators(model):
        joint = _joint_of(model, at)
        joints = [joint] if joint else []
    elif mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, at) > 0:
        body = model.body(at)
        joints = [model.joint(int(body.jntadr[0]) + i).name for i in range(int(body.jntnum[0]))]
    else:
        return names
    for joint in joints:
        names |= {joint, _body_of(model, joint), *_actuators_of(model, joint)}
    return names


def _joint_names(model: mujoco.MjModel) -> list[str]:
    return [model.joint(j).name for j in range(model.njnt)]


def _is_joint_motor(model: mujoco.MjModel, i: int) -> bool:
    return int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_JOINT)


def actuators(model: mujoco.MjModel) -> dict[str, int]:
    """Actuators by the name that reports use: their own, or else that of the joint which they drive."""
    names = {}
    for i in range(model.nu):
        own = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, i)
        names[own or model.joint(int(model.actuator_trnid[i, 0])).name] = i
    return names


def _joint_of(model: mujoco.MjModel, actuator: str) -> str:
    i = actuators(model)[actuator]
    return model.joint(int(model.actuator_trnid[i, 0])).name if _is_joint_motor(model, i) else ""


def _actuators_of(model: mujoco.MjModel, joint: str) -> list[str]:
    return [name for name in actuators(model) if _joint_of(model, name) == joint]


def _body_of(model: mujoco.MjModel, joint: str) -> str:
    return model.body(int(model.joint(joint).bodyid[0])).name


def _is_first(model: mujoco.MjModel, joint: str) -> bool:
    body = int(model.joint(joint).bodyid[0])
    return int(model.body_parentid[body]) == 0 and int(model.body_jntnum[body]) == 1


def _drives_slide(model: mujoco.MjModel, actuator: str) -> bool:
    joint = _joint_of(model, actuator)
    return bool(joint) and int(model.joint(joint).type[0]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
