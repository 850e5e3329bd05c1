"""What a machine does in nominal motion: the scales from which effects of a visible, physical size are drawn."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from experiments.blind.truth.simulate import Trajectory

Array = NDArray[np.float64]


class Statistics:
    """Scales over the given runs of the nominal machine, addressed by MJCF names."""

    def __init__(self, model: mujoco.MjModel, runs: list[Trajectory]):
        self.model, self.runs = model, runs
        data = mujoco.MjData(model)
        torque, inertia, centre = [], [], []
        for run in runs:
            acceleration = np.gradient(run.qvel, run.time, axis=0)
            for row in range(0, len(run.time), 5):
                data.qpos[:], data.qvel[:] = run.qpos[row], run.qvel[row]
                mujoco.mj_forward(model, data)
                full = np.zeros((model.nv, model.nv))
                mujoco.mj_fullM(model, data, full)
                torque.append(np.diag(full) * acceleration[row] + data.qfrc_bias)
                inertia.append(np.diag(full))
                centre.append(self._body_velocities(data))
        self.torque_rms = np.sqrt(np.mean(np.square(torque), 0))
        self.inertia_mean = np.mean(inertia, 0)
        self.body_speed_rms = np.sqrt(np.mean(np.square(centre), 0))
        self.qpos = np.concatenate([run.qpos for run in runs])
        self.qvel = np.concatenate([run.qvel for run in runs])
        self.forces = np.concatenate([run.force for run in runs])

    def _body_velocities(self, data: mujoco.MjData) -> Array:
        out, spatial = np.zeros(self.model.nbody), np.zeros(6)
        for body in range(1, self.model.nbody):
            mujoco.mj_objectVelocity(self.model, data, mujoco.mjtObj.mjOBJ_BODY, body, spatial, 0)
            out[body] = np.linalg.norm(spatial[3:])
        return out

    def torque(self, joint: str) -> float:
        """Root mean square of own inertia times acceleration plus gravity and Coriolis [N m or N]."""
        return float(self.torque_rms[self.dof(joint)])

    def speed(self, joint: str) -> float:
        """Root mean square joint velocity."""
        return float(np.sqrt((self.qvel[:, self.dof(joint)] ** 2).mean()))

    def inertia(self, joint: str) -> float:
        """Mean own entry of the mass matrix."""
        return float(self.inertia_mean[self.dof(joint)])

    def position(self, joint: str) -> Array:
        """All positions [rows] of a joint."""
        return self.qpos[:, self.model.joint(joint).qposadr[0]]

    def force(self, actuator: int) -> Array:
        """All forces [rows] of an actuator."""
        return self.forces[:, actuator]

    def body_speed(self, body: str) -> float:
        """Root mean square speed of a body's centre of mass [m/s]."""
        return float(self.body_speed_rms[self.model.body(body).id])

    def weight(self, body: str) -> float:
        """Weight [N] of a body and all below it."""
        return float(self.model.body_subtreemass[self.model.body(body).id]) * 9.81

    def dof(self, joint: str) -> int:
        """First degree of freedom of a joint."""
        return int(self.model.joint(joint).dofadr[0])
