"""How much of a hidden force no simpler effect could imitate: the draw keeps clear of what data cannot tell apart."""

import mujoco
import numpy as np

from experiments.blind.truth.simulate import Trajectory
from experiments.blind.vocabulary import Effect


def distinct_share(effect: Effect, model: mujoco.MjModel, runs: list[Trajectory]) -> float:
    """1 - the share of the effect's own force that a regression on its simpler rivals explains (root of squares).

    Only for effects that are forces in one joint and have a simpler rival of the same kind; 1 for all others.
    """
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, effect.at)
    if joint < 0 or (effect.id not in RIVALS and not effect.unknown):
        return 1.0
    dof, column = model.jnt_dofadr[joint], model.jnt_qposadr[joint]
    q = np.concatenate([run.qpos[:, column] for run in runs])
    v = np.concatenate([run.qvel[:, dof] for run in runs])
    force = np.concatenate([run.extra[:, dof] for run in runs])
    moving = np.abs(v) > 0.02 * np.abs(v).max()
    terms = {
        "one": np.ones_like(v),
        "sign": np.sign(v),
        "v": v,
        "v|v|": v * np.abs(v),
        "q": q,
        "sin": np.sin(q),
        "cos": np.cos(q),
    }
    names = terms if effect.unknown else RIVALS[effect.id]
    design = np.stack([terms[name] for name in names], 1)[moving]
    target = force[moving]
    if not np.any(target):
        return 0.0
    rest = target - design @ np.linalg.lstsq(design, target, rcond=None)[0]
    return float(np.sqrt((rest**2).sum() / (target**2).sum()))


RIVALS = {
    "stribeck_friction": ("sign", "v"),
    "load_dependent_friction": ("sign", "v"),
    "asymmetric_friction": ("sign", "v"),
    "quadratic_drag": ("v", "sign"),
    "coulomb_friction": ("v", "v|v|"),
    "viscous_damping": ("sign", "v|v|"),
    "cogging_torque": ("one", "sin", "cos", "q"),
}
