"""The true machine: a nominal MJCF stepped finely by MuJoCo, with hidden physics added as stages in every sub-step.

Actuators become plain motors whose force is computed here from the nominal law, so that every stage (delay, lag,
gain, clip...) is explicit. Dry friction is an impulse-level projection (Moreau's time stepping): exact sticking,
exactly the stated level when sliding.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

from experiments.blind.truth.stages import Stages

Array = NDArray[np.float64]
Joint = mujoco.mjtObj.mjOBJ_JOINT


class Unstable(RuntimeError):
    """The simulated machine left every sensible range; draw another one."""


class Plant:
    """One machine. `q(name)`, `v(name)` and `dof(name)` address joints by their MJCF names."""

    def __init__(self, path: str, dt: float, integrator: str, stages: "Stages[Plant]"):
        if integrator not in ("Euler", "implicitfast", "implicit"):
            raise ValueError(
                f"integrator {integrator!r} cannot be stepped in halves; use Euler, implicit or implicitfast"
            )
        self.dt, self.stages = dt, stages
        spec = mujoco.MjSpec.from_file(path)
        nominal = spec.compile()
        self.nominal = nominal
        self._check(nominal)
        self.gain, self.bias = nominal.actuator_gainprm[:, 0].copy(), nominal.actuator_biasprm[:, :3].copy()
        self.bias[nominal.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE] = 0
        self.servo = bool(self.bias.any())
        self.ctrl_range = _range(nominal.actuator_ctrllimited, nominal.actuator_ctrlrange)
        self.force_range = _range(nominal.actuator_forcelimited, nominal.actuator_forcerange)
        for edit in stages.spec:
            edit(spec)
        for index, actuator in enumerate(spec.actuators):
            joint = stages.drive_joint.get(actuator.target)
            if joint is not None:
                actuator.target = joint
            _plain_motor(actuator, nominal.actuator_gear[index])
        self.model = spec.compile()
        self.model.opt.timestep = dt
        self.model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
        self._map_joints()
        for tune in stages.model:
            tune(self)
        self.data = mujoco.MjData(self.model)
        self.friction = [make(self) for make in stages.friction]
        self.friction_dofs = np.array([f.dof for f in self.friction], dtype=int)
        self.friction_unit = np.eye(self.model.nv)[self.friction_dofs]
        self.force = np.zeros(nominal.nu)  # actuator_force of the last sub-step
        self.extra = np.zeros(self.model.nv)  # generalised force that the joint stages added in it

    @staticmethod
    def _check(model: mujoco.MjModel) -> None:
        plain = (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE) & (
            model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
        )
        affine = np.isin(model.actuator_biastype, (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE))
        if not (plain & affine).all():
            raise ValueError(
                "only motors and position or velocity servos without internal state are supported"
            )

    def _map_joints(self) -> None:
        qpos, dof = [], []
        for j in range(self.nominal.njnt):
            name = mujoco.mj_id2name(self.nominal, Joint, j)
            here = self.model.joint(name)
            qpos += list(range(here.qposadr[0], here.qposadr[0] + len(here.qpos0)))
            dof += list(range(here.dofadr[0], here.dofadr[0] + len(here.damping)))
        self.qpos_of, self.dof_of = np.array(qpos), np.array(dof)
        joints = [self.model.joint(j) for j in range(self.model.njnt)]
        self._address = {j.name: (int(j.qposadr[0]), int(j.dofadr[0])) for j in joints}

    def dof(self, joint: str) -> int:
        """Address of the joint's (first) degree of freedom in this plant."""
        return self._address[joint][1]

    def q(self, joint: str) -> float:
        """Position of a hinge or slide joint."""
        return float(self.data.qpos[self._address[joint][0]])

    def v(self, joint: str) -> float:
        """Velocity of a hinge or slide joint."""
        return float(self.data.qvel[self.dof(joint)])

    def actuator(self, name: str) -> int:
        """Index of an actuator; one without a name goes by the joint that it drives."""
        index = mujoco.mj_name2id(self.nominal, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
        if index >= 0:
            return index
        unnamed = [
            i
            for i, _ in self.drivers(name)
            if not mujoco.mj_id2name(self.nominal, mujoco.mjtObj.mjOBJ_ACTUATOR, i)
        ]
        if len(unnamed) != 1:
            raise ValueError(f"the model has no actuator {name!r}")
        return unnamed[0]

    def drivers(self, joint: str) -> list[tuple[int, float]]:
        """Actuators that the nominal model hangs on a joint, with their gears."""
        m = self.nominal
        j = m.joint(joint).id
        on = (m.actuator_trnid[:, 0] == j) & (m.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
        return [(int(i), float(m.actuator_gear[i, 0])) for i in np.flatnonzero(on)]

    def reset(self, qpos: Array, qvel: Array) -> None:
        """Start in a state of the nominal joints; anything added (a rotor) starts in line with its joint."""
        mujoco.mj_resetData(self.model, self.data)
        for forget in self.stages.restart:
            forget()
        self.data.qpos[self.qpos_of] = qpos
        self.data.qvel[self.dof_of] = qvel
        for joint, rotor in self.stages.drive_joint.items():
            self.data.qpos[self._address[rotor][0]] = self.q(joint)
            self.data.qvel[self.dof(rotor)] = self.v(joint)

    @property
    def joints(self) -> set[str]:
        """Names of all joints."""
        return set(self._address)

    def body_velocity(self, body: str) -> Array:
        """Linear velocity [3] of a body's centre of mass, world frame."""
        spatial = np.zeros(6)
        b = self.model.body(body).id
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_BODY, b, spatial, 0)
        return spatial[3:]

    def push(self, body: str, force: Array, extra: Array) -> None:
        """Add the generalised force of a world-frame force [3] at the body's centre of mass."""
        b = self.model.body(body).id
        mujoco.mj_applyFT(self.model, self.data, force, np.zeros(3), self.data.xipos[b], b, extra)

    def refresh(self) -> None:
        """Recompute what MuJoCo derives from masses, after an edit of the compiled model."""
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))

    def state(self) -> tuple[Array, Array]:
        """True positions and velocities of the nominal joints, in the nominal order."""
        return self.data.qpos[self.qpos_of].copy(), self.data.qvel[self.dof_of].copy()

    def substep(self, command: Array) -> None:
        """Advance by `dt` under a command [nu] that already went through the command stages."""
        m, d = self.model, self.data
        mujoco.mj_step1(m, d)
        f = self.gain * _clip(command, self.ctrl_range)
        if self.servo:
            f += self.bias[:, 0] + self.bias[:, 1] * d.actuator_length + self.bias[:, 2] * d.actuator_velocity
        f = _clip(f, self.force_range)
        for stage in self.stages.force:
            f = stage(self, f)
        self.force = f
        d.ctrl[:] = f
        extra = np.zeros(m.nv)
        for add in self.stages.joint:
            add(self, extra)
        self.extra = extra
        d.qfrc_applied[:] = extra
        if self.friction:
            self._apply_friction()
        mujoco.mj_step2(m, d)

    def _apply_friction(self) -> None:
        """Impulses that stop each joint, cut at the friction level: v + dt (a + M^-1 tau) = 0 within the bounds."""
        m, d = self.model, self.data
        mujoco.mj_fwdActuation(m, d)
        mujoco.mj_fwdAcceleration(m, d)
        mujoco.mj_fwdConstraint(m, d)
        dofs, inverse = self.friction_dofs, np.zeros_like(self.friction_unit)
        mujoco.mj_solveM(m, d, inverse, self.friction_unit)
        a = inverse[:, dofs]
        free = d.qvel[dofs] / self.dt + d.qacc[dofs]
        bounds = [
            f.level(float(d.qvel[f.dof]), abs(sum(gear * self.force[i] for i, gear in f.actuators)))
            for f in self.friction
        ]
        tau = _projected(a, free, np.array(bounds))
        d.qfrc_applied[dofs] += tau
        self.extra[dofs] += tau


def _projected(a: Array, free: Array, bounds: Array) -> Array:
    """tau within [-bounds[:, 0], bounds[:, 1]] with a tau + free = 0 wherever it is inside (Gauss-Seidel)."""
    tau = np.asarray(np.linalg.solve(a, -free), float)
    if (tau >= -bounds[:, 0]).all() and (tau <= bounds[:, 1]).all():
        return tau
    tau = np.minimum(np.maximum(tau, -bounds[:, 0]), bounds[:, 1])
    for _ in range(0 if len(free) == 1 else 200):
        before = tau.copy()
        for i in range(len(free)):
            rest = free[i] + a[i] @ tau - a[i, i] * tau[i]
            tau[i] = min(max(-rest / a[i, i], -bounds[i, 0]), bounds[i, 1])
        if np.abs(tau - before).max() <= 1e-9 * np.abs(tau).max():
            break
    return tau


def _clip(x: Array, bounds: tuple[Array, Array]) -> Array:
    return np.minimum(np.maximum(x, bounds[0]), bounds[1])


def _range(limited: Array, bounds: Array) -> tuple[Array, Array]:
    on = limited.astype(bool)
    return np.where(on, bounds[:, 0], -np.inf), np.where(on, bounds[:, 1], np.inf)


def _plain_motor(actuator: mujoco.MjsActuator, gear: Array) -> None:
    """Force equals control: the law of the nominal actuator is evaluated by the plant itself."""
    actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_NONE
    actuator.gainprm[:], actuator.biasprm[:] = 0, 0
    actuator.gainprm[0] = 1
    actuator.gear[:] = gear
    actuator.ctrllimited = actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
