"""Load a MuJoCo model so that every parameter can vary at run time, and name its parts."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mpge_jax.diagnosis.errors import InputError
from mpge_jax.diagnosis.machine import model_files
from mpge_jax.diagnosis.machine.simple_bodies import as_compiled, only_slide

TAKEN = 9
"""Where in `actuator_biasprm` the gain on speed of a drive lies that an effect computes in place of the engine, which
reads the first three numbers only."""
POSES = 4
"""Random poses, in which whatever can act on a joint does."""
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def load_spec(source: str | Path | mujoco.MjSpec, text: bytes | None = None) -> mujoco.MjSpec:
    """Read a model description, which may refer to the files that `model_files` allows.

    Args:
        source: a file, or a description. text: what the file is to contain, in place of what it does.

    Raises:
        InputError: the file is missing, malformed, or refers to files that it may not read.
    """
    if isinstance(source, mujoco.MjSpec):
        return _explicit(source.copy())
    if not isinstance(source, str | Path):
        raise InputError(f"a model is the path of a file or an MjSpec, not {type(source).__name__}.")
    path = Path(source)
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise InputError(f"the model file {path} {what}; give the path of an MJCF or URDF file.")
    model_files.check(path.resolve())
    try:
        return _explicit(model_files.read_spec(path.resolve(), text))
    except InputError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"MuJoCo cannot load {path.name}: {' '.join(str(error).split())}") from None


def _explicit(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """`spec`, changed in place so that its elements say what settings of the whole model say of them."""
    _replace_total_mass(spec)
    if spec.option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL):
        for actuator in spec.actuators:
            actuator.ctrllimited = int(mujoco.mjtLimited.mjLIMITED_FALSE)
    _replace_what_follows_masses(spec)
    return spec


def _replace_what_follows_masses(spec: mujoco.MjSpec) -> None:
    """Write what the compiler derives from the masses or the pose as numbers, which effects can change and masses that
    are changed do not: damping ratios, spring-dampers, rest lengths of tendons, peak forces of muscles. A joint's limit
    on its only motor becomes the motor's."""
    derived = any(
        (a.gaintype == mujoco.mjtGain.mjGAIN_MUSCLE and a.gainprm[2] < 0) or a.biasprm[2] > 0
        for a in spec.actuators
    )
    derived |= any(np.any(np.array(j.springdamper) > 0) or np.any(j.actfrcrange) for j in spec.joints)
    derived |= any(t.springlength[0] < 0 for t in spec.tendons)
    if not derived:
        return
    m = spec.compile()
    shared = _moved_otherwise(m) if m.jnt_actfrclimited.any() else np.zeros(m.nv, bool)
    for a in spec.actuators:
        i, muscle = a.id, m.actuator_gaintype[a.id] == mujoco.mjtGain.mjGAIN_MUSCLE
        if muscle and a.gainprm[2] < 0:
            peak = a.gainprm[3] / max(float(m.actuator_acc0[i]), 1e-15)
            a.gainprm, a.biasprm = (
                np.concatenate([prm[:2], [peak], prm[3:]])
                for prm in (np.array(a.gainprm), np.array(a.biasprm))
            )
        elif not muscle and a.biasprm[2] > 0:
            a.biasprm = m.actuator_biasprm[i]
        joint = int(m.actuator_trnid[i, 0])
        alone = is_joint_transmission(m, i) and len(actuators_of_joint(m, joint)) == 1
        alone = alone and not m.jnt_actgravcomp[joint] and not shared[m.jnt_dofadr[joint]]
        gear = float(m.actuator_gear[i, 0])
        if alone and m.jnt_actfrclimited[joint] and gear != 0.0:
            given = m.actuator_forcerange[i] if m.actuator_forcelimited[i] else np.array([-np.inf, np.inf])
            low, high = np.sort(m.jnt_actfrcrange[joint] / gear)
            a.forcelimited = int(mujoco.mjtLimited.mjLIMITED_TRUE)
            a.forcerange = [max(low, given[0]), min(high, given[1])]
    for j in spec.joints:
        if np.any(np.array(j.springdamper) > 0):
            dof = int(m.jnt_dofadr[j.id])
            stiffness, damping = np.array(j.stiffness, dtype=float), np.array(j.damping, dtype=float)
            stiffness[0], damping[0] = m.jnt_stiffness[j.id], m.dof_damping[dof]
            j.stiffness, j.damping, j.springdamper = stiffness, damping, [0.0, 0.0]
    for t in spec.tendons:
        if t.springlength[0] < 0:
            t.springlength = m.tendon_lengthspring[t.id]


def _moved_otherwise(m: mujoco.MjModel) -> np.ndarray:
    """Degrees of freedom [nv] on which tendons, sites or bodies that are driven may act, judged in several poses."""
    others = np.array([not is_joint_transmission(m, a) for a in range(m.nu)], bool)
    if (m.actuator_trntype == mujoco.mjtTrn.mjTRN_BODY).any():
        # adhesion acts where bodies touch, which no pose tells
        return np.ones(m.nv, bool)
    out, data, rng = np.zeros(m.nv, bool), mujoco.MjData(m), np.random.default_rng(0)
    for _ in range(POSES if others.any() else 0):
        data.qpos[:] = m.qpos0
        mujoco.mj_integratePos(m, data.qpos, rng.standard_normal(m.nv), 1.0)
        mujoco.mj_fwdPosition(m, data)
        out |= (moments(m, data)[others] != 0).any(0)
    return out


def _replace_total_mass(spec: mujoco.MjSpec) -> None:
    """Write the masses that the deprecated `settotalmass` would give into the bodies, and remove it."""
    total = float(spec.compiler.settotalmass)
    if total <= 0:
        return
    spec.compiler.settotalmass = -1
    plain = spec.compile()
    factor = total / float(plain.body_mass.sum())
    for body in spec.bodies[1:]:
        i = body.id
        if plain.body_mass[i] > 0:
            body.explicitinertial = True
            body.mass = float(plain.body_mass[i]) * factor
            body.ipos, body.iquat = plain.body_ipos[i], plain.body_iquat[i]
            body.inertia = plain.body_inertia[i] * factor
            body.fullinertia = np.full(6, np.nan)
    spec.compiler.inertiafromgeom = int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE)


def compile_variable(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile with the constant-inertia shortcuts off, so that masses and frames may vary per simulation."""
    try:
        spec = _explicit(spec.copy())
        plain = spec.copy()
        for body in spec.bodies[1:]:
            body.simple = False
        model = spec.compile()
        if only_slide(model).any():
            as_compiled(model, plain.compile())
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"MuJoCo cannot compile the model: {' '.join(str(error).split())}") from None
    model.actuator_biasprm[model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE, TAKEN] = 0.0
    if not model.nu == model.nactuator == model.nout:
        raise InputError(
            "the model has actuators with several inputs or outputs (pid, orientation), which are not supported; "
            "replace them by motors or servos."
        )
    if model.opt.timestep <= 0:
        raise InputError("the model's timestep is 0; give it one of some milliseconds.")
    if model.nv == 0:
        raise InputError("the model has no joint, so there is nothing to diagnose.")
    return model


@dataclass(frozen=True)
class Names:
    """Names of a model's parts as reports use them; unnamed parts go by kind and index."""

    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    bodies: tuple[str, ...]
    geoms: tuple[str, ...]

    def joint_of_dof(self, model: mujoco.MjModel, dof: int) -> str:
        return self.joints[int(model.dof_jntid[dof])]

    def driven_by(self, model: mujoco.MjModel, a: int) -> str:
        """The joint that an actuator drives, or the actuator's own name where it drives no single one."""
        return (
            self.joints[int(model.actuator_trnid[a, 0])]
            if is_joint_transmission(model, a)
            else self.actuators[a]
        )


def names_of(model: mujoco.MjModel) -> Names:
    """Names of joints, actuators, bodies, geoms, each once. An unnamed actuator goes by its joint, if no other does."""

    def names(
        kind: mujoco.mjtObj, size: int, word: str, instead: dict[int, str] | None = None
    ) -> tuple[str, ...]:
        out = [mujoco.mj_id2name(model, kind, i) for i in range(size)]
        for i in (i for i in range(size) if not out[i]):
            made_up = (f"{word}_{i}" + "_" * more for more in count())
            out[i] = next(
                name for name in chain([(instead or {}).get(i)], made_up) if name not in (None, *out)
            )
        return tuple(out)

    obj = mujoco.mjtObj
    joints = names(obj.mjOBJ_JOINT, model.njnt, "joint")
    direct = [a for a in range(model.nu) if is_joint_transmission(model, a)]
    by_joint = {a: joints[int(model.actuator_trnid[a, 0])] for a in direct}
    actuators = names(obj.mjOBJ_ACTUATOR, model.nu, "actuator", by_joint)
    bodies = ("world", *names(obj.mjOBJ_BODY, model.nbody, "body")[1:])
    return Names(joints, actuators, bodies, names(obj.mjOBJ_GEOM, model.ngeom, "geom"))


def is_joint_transmission(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether the actuator drives one hinge or slide joint directly."""
    direct = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    if int(model.actuator_trntype[actuator]) not in direct:
        return False
    return is_scalar(model, int(model.actuator_trnid[actuator, 0]))


def weighed_by_torque(model: mujoco.MjModel, joint: int) -> bool:
    """Whether all that drives a joint are motors, so that its torque is known (see `check_units`)."""
    own = actuators_of_joint(model, joint)
    return bool(own) and all(model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE for a in own)


def has_plain_law(model: mujoco.MjModel, a: int) -> bool:
    """Whether an actuator's force is a function of its command and, if any, its joint's position and velocity."""
    no_state = model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_NONE
    fixed = model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
    bias = model.actuator_biastype[a]
    linear = bias == mujoco.mjtBias.mjBIAS_NONE or bias == mujoco.mjtBias.mjBIAS_AFFINE
    at_once = model.actuator_delay[a] == 0 and model.actuator_plugin[a] < 0
    # without a bias, what it drives does not matter
    known = bias == mujoco.mjtBias.mjBIAS_NONE or is_joint_transmission(model, a)
    return bool(no_state and fixed and linear and at_once and known)


def command_limits(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest command [nu] that each actuator obeys; infinite where nothing limits it."""
    limited = model.actuator_ctrllimited.astype(bool)
    limited &= not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -np.inf)
    return low, np.where(limited, model.actuator_ctrlrange[:, 1], np.inf)


def clipped(model: mujoco.MjModel, ctrl: Any, xp: Any = np) -> Any:
    """Commands [..., nu] within the limits of the actuators that have any; whatever a drive does, it does to these."""
    return within(ctrl, *command_limits(model), xp)


def within(x: Any, low: Any, high: Any, xp: Any = np) -> Any:
    """`clip`, of which numpy's takes several times as long for so few numbers as are clipped at every step."""
    return xp.minimum(xp.maximum(x, low), high)


def is_scalar(model: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint is a hinge or a slide."""
    return int(model.jnt_type[joint]) in (_HINGE, _SLIDE)


def scalar_joints(model: mujoco.MjModel) -> list[int]:
    """Indices of hinge and slide joints."""
    return [j for j in range(model.njnt) if is_scalar(model, j)]


def qpos_columns(model: mujoco.MjModel, joint: int) -> tuple[int, int]:
    """First column of a joint in qpos, and the one after its last."""
    end = int(model.jnt_qposadr[joint + 1]) if joint + 1 < model.njnt else model.nq
    return int(model.jnt_qposadr[joint]), end


def floating_base_joints(model: mujoco.MjModel) -> set[int]:
    """Joints that place a floating base in the world: free joints, and three or more joints on one root body of which
    no actuator drives one (a gantry's, a gimbal's or a shoulder's are driven) and none springs, is damped or rubs (a
    suspension's do).

    They stand for no machine part, so effects of drives and bearings are not looked for there.
    """
    parts = {int(model.actuator_trnid[a, 0]) for a in range(model.nu) if is_joint_transmission(model, a)}
    parts |= {int(model.dof_jntid[d]) for d in np.flatnonzero(model.dof_damping + model.dof_frictionloss)}
    parts |= set(map(int, np.flatnonzero(model.jnt_stiffness)))
    base: set[int] = set()
    for body in range(1, model.nbody):
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        joints = set(range(first, first + count)) if count else set()
        if any(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE for j in joints) or (
            count >= 3 and model.body_parentid[body] == 0 and not joints & parts
        ):
            base |= joints
    return base


def actuators_of_joint(model: mujoco.MjModel, joint: int) -> list[int]:
    # asked at every step of what drives hide
    drives = enumerate(model.actuator_trnid[:, 0].tolist())
    return [a for a, driven in drives if driven == joint and is_joint_transmission(model, a)]


def lever_arms(model: mujoco.MjModel, joint: int) -> list[tuple[int, float]]:
    """The actuators whose force acts on a joint, directly or by a fixed tendon, each with the torque on the joint for a
    unit of its force."""
    arms = [(a, float(model.actuator_gear[a, 0])) for a in actuators_of_joint(model, joint)]
    # asked at every step
    if not model.ntendon:
        return arms
    for a in np.flatnonzero(model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON)).tolist():
        tendon = int(model.actuator_trnid[a, 0])
        part = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
        on = (model.wrap_type[part] == int(mujoco.mjtWrap.mjWRAP_JOINT)) & (model.wrap_objid[part] == joint)
        if on.any():
            arms.append((a, float(model.actuator_gear[a, 0] * model.wrap_prm[part][on].sum())))
    return arms


def free_inertia(model: mujoco.MjModel, factor: np.ndarray, dof: int) -> np.ndarray:
    """Inertia [...] with which a joint resists a torque while all others are free: the inverse of the diagonal element
    of the inverse mass matrix.

    Args:
        factor: [..., nC] `MjData.qLD`, the factors L (unit diagonal, left out) and D of the mass matrix L^T D L.
    """
    start = model.M_rowadr
    # a row of the factors holds a joint's ancestors from the root on, and itself
    chain = model.M_colind[start[dof] : start[dof] + model.M_rownnz[dof]].tolist()
    # L^T x = e, which is other than 0 along the chain only
    x: list[Any] = [1.0]
    for j in range(len(chain) - 2, -1, -1):
        x.insert(0, -sum(factor[..., start[i] + j] * x_i for i, x_i in zip(chain[j + 1 :], x, strict=True)))
    return 1.0 / sum(
        x_i**2 / factor[..., start[i] + k] for k, (i, x_i) in enumerate(zip(chain, x, strict=True))
    )


def rotor_inertia(model: mujoco.MjModel, joint: int) -> float:
    """Inertia of what turns with the motors of a scalar joint, as felt at the joint: its own armature and theirs."""
    geared = [
        float(model.actuator_armature[a] * model.actuator_gear[a, 0] ** 2)
        for a in actuators_of_joint(model, joint)
    ]
    return float(model.dof_armature[model.jnt_dofadr[joint]]) + sum(geared)


def moments(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Moment arms [nu, nv] of the actuators in the pose of `data`, whose transmissions are computed."""
    out = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        out, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    return out


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """Bodies that forces can move and that carry mass."""
    held = (model.body_weldid == 0) | (model.body_mocapid[model.body_weldid] >= 0)
    carries = (model.body_mass > 0) & np.isfinite(model.body_mass)
    return np.flatnonzero(~held & carries).tolist()
