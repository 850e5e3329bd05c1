"""Controllers: each turns measured positions into commands, so that the motion of the machine looks right.

They know the nominal model only. A controller is called once for every recorded row and its command is held until
the next one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are
from scipy.spatial.transform import Rotation

from experiments.blind.truth.excitation import Reference

Array = NDArray[np.float64]
VELOCITY_FILTER = 0.012  # s


class Controller(Protocol):
    """`command(row, t, q, v)` returns [nu]; q [nq] as measured, v [nv] as estimated."""

    def command(self, row: int, t: float, q: Array, v: Array) -> Array: ...


class VelocityEstimate:
    """Filtered differences of measured positions."""

    def __init__(self, model: mujoco.MjModel):
        self.model, self.v = model, np.zeros(model.nv)
        self.last: tuple[float, Array] | None = None

    def update(self, t: float, q: Array) -> Array:
        """Velocity [nv] after the measurement q at time t."""
        if self.last is not None:
            dt, raw = t - self.last[0], np.zeros(self.model.nv)
            mujoco.mj_differentiatePos(self.model, raw, dt, self.last[1], q)
            self.v = self.v + dt / (dt + VELOCITY_FILTER) * (raw - self.v)
        self.last = (t, q.copy())
        return self.v


def inverse_dynamics(model: mujoco.MjModel, ref: Reference) -> Array:
    """Generalised forces [T, nv] that follow a reference of all joints in the nominal model."""
    data, out = mujoco.MjData(model), np.zeros_like(ref.v)
    for row in range(len(ref.q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = ref.q[row], ref.v[row], ref.a[row]
        mujoco.mj_inverse(model, data)
        out[row] = data.qfrc_inverse
    return out


@dataclass
class Torque:
    """Computed torque for a fully actuated arm with motors: feed-forward and a PD of given bandwidth [rad/s]."""

    model: mujoco.MjModel
    ref: Reference
    bandwidth: float

    def __post_init__(self) -> None:
        self.forward = inverse_dynamics(self.model, self.ref)
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.ref.q.mean(0)
        mujoco.mj_forward(self.model, data)
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, full)
        self.inertia = np.diag(full)
        self.gear = self.model.actuator_gear[:, 0] * self.model.actuator_gainprm[:, 0]

    def command(self, row: int, t: float, q: Array, v: Array) -> Array:
        w = self.bandwidth
        feedback = w**2 * (self.ref.q[row] - q) + 1.6 * w * (self.ref.v[row] - v)
        return (self.forward[row] + self.inertia * feedback) / self.gear


@dataclass
class Servo:
    """Position servos follow the reference by themselves; the command leads by the velocity gain's lag."""

    model: mujoco.MjModel
    ref: Reference
    bandwidth: float

    def command(self, row: int, t: float, q: Array, v: Array) -> Array:
        lag = -self.model.actuator_biasprm[:, 2] / self.model.actuator_gainprm[:, 0]
        return self.ref.q[row] + lag * self.ref.v[row]


@dataclass
class Joints:
    """PD on the actuated joints of a machine with a free or guided base; gains in torque per radian."""

    model: mujoco.MjModel
    ref: Reference
    bandwidth: float

    def __post_init__(self) -> None:
        joints = self.model.actuator_trnid[:, 0]
        self.qpos, self.dof = self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints]
        self.gear = self.model.actuator_gear[:, 0]
        strength = self.gear * self.model.actuator_ctrlrange[:, 1]
        self.kp = strength * self.bandwidth / 10
        self.kd = 0.06 * self.kp

    def command(self, row: int, t: float, q: Array, v: Array) -> Array:
        e, de = self.ref.q[row] - q[self.qpos], self.ref.v[row] - v[self.dof]
        return (self.kp * e + self.kd * de) / self.gear


@dataclass
class Cart:
    """Linear-quadratic regulator about the rest pose; the reference is the cart's position (first joint)."""

    model: mujoco.MjModel
    ref: Reference
    bandwidth: float

    def __post_init__(self) -> None:
        m = self.model
        data = mujoco.MjData(m)
        a, b = np.zeros((2 * m.nv, 2 * m.nv)), np.zeros((2 * m.nv, m.nu))
        mujoco.mj_forward(m, data)
        integrator, m.opt.integrator = (
            m.opt.integrator,
            mujoco.mjtIntegrator.mjINT_EULER,
        )  # no derivatives of RK4
        mujoco.mjd_transitionFD(m, data, 1e-6, True, a, b, None, None)
        m.opt.integrator = integrator
        state, effort = np.ones(2 * m.nv), 1 / m.actuator_ctrlrange[:, 1] ** 2
        state[0] = 10 * self.bandwidth
        p = solve_discrete_are(a, b, np.diag(state), np.diag(20 * effort))
        self.gain = np.linalg.solve(np.diag(20 * effort) + b.T @ p @ b, b.T @ p @ a)

    def command(self, row: int, t: float, q: Array, v: Array) -> Array:
        target = np.zeros(2 * self.model.nv)
        target[0], target[self.model.nv] = self.ref.q[row, 0], self.ref.v[row, 0]
        return self.gain @ (target - np.concatenate([q, v]))


@dataclass
class Drone:
    """Planar multirotor: position loop around an attitude loop; joints x, z, pitch first, two thrusts."""

    model: mujoco.MjModel
    ref: Reference
    bandwidth: float

    def command(self, row: int, t: float, q: Array, v: Array) -> Array:
        m, w, g = self.model, self.bandwidth, -self.model.opt.gravity[2]
        mass, arm = float(m.body_mass.sum()), float(abs(m.site_pos[0, 0]))
        wish = self.ref.a[row] + w**2 * (self.ref.q[row] - q[:2]) + 1.8 * w * (self.ref.v[row] - v[:2])
        pitch = np.clip(wish[0] / g, -0.5, 0.5)
        fast = 3.5 * w
        torque = m.body("frame").inertia[1] * (fast**2 * (pitch - q[2]) - 1.6 * fast * v[2])
        thrust = mass * (g + np.clip(wish[1], -5, 5)) / np.cos(np.clip(q[2], -0.8, 0.8))
        return np.array([thrust / 2 - torque / (2 * arm), thrust / 2 + torque / (2 * arm)])


@dataclass
class Push:
    """A block on a floor: planar position control by force, with a swinging downward load; refs x, y, lift, yaw."""

    model: mujoco.MjModel
    ref: Reference
    bandwidth: float

    def command(self, row: int, t: float, q: Array, v: Array) -> Array:
        w, mass = self.bandwidth, float(self.model.body_mass.sum())
        force = mass * (
            self.ref.a[row, :2] + w**2 * (self.ref.q[row, :2] - q[:2]) + w * (self.ref.v[row, :2] - v[:2])
        )
        yaw = 0.05 * w**2 * (self.ref.q[row, 3] - q[3]) + 0.05 * w * (self.ref.v[row, 3] - v[3])
        weight = mass * 9.81
        friction = 0.4 * max(weight - weight * self.ref.q[row, 2], 0.0) * np.tanh(self.ref.v[row, :2] / 0.05)
        return np.array([*(force + friction), weight * self.ref.q[row, 2], yaw])


@dataclass
class Quad:
    """Quadrotor with a free joint: position loop, then the attitude that points the thrust; heading zero."""

    model: mujoco.MjModel
    ref: Reference
    bandwidth: float

    def __post_init__(self) -> None:
        m = self.model
        x, y = m.site_pos[:, 0], m.site_pos[:, 1]
        self.mixer = np.linalg.inv(np.stack([np.ones(4), y, -x, m.actuator_gear[:, 5]]))

    def command(self, row: int, t: float, q: Array, v: Array) -> Array:
        m, w = self.model, self.bandwidth
        wish = self.ref.a[row] + w**2 * (self.ref.q[row] - q[:3]) + 1.8 * w * (self.ref.v[row] - v[:3])
        wish = np.clip(wish, -4, 4) - m.opt.gravity
        to_world = Rotation.from_quat(np.roll(q[3:], -1)).as_matrix()
        mass, up = float(m.body_mass.sum()), to_world[:, 2]
        error = to_world.T @ np.cross(up, wish / np.linalg.norm(wish))
        error[2] = -0.3 * np.arctan2(to_world[1, 0], to_world[0, 0])
        fast = 3.5 * w
        torque = m.body("frame").inertia * (fast**2 * error - 1.6 * fast * v[3:])
        return self.mixer @ np.concatenate([[mass * wish @ up], torque])


CONTROLLERS: dict[str, Callable[[mujoco.MjModel, Reference, float], Controller]] = {
    "torque": Torque,
    "servo": Servo,
    "joints": Joints,
    "cart": Cart,
    "drone": Drone,
    "push": Push,
    "quad": Quad,
}
