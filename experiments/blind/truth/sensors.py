"""What measuring does: noise, encoder steps, missing velocities and forces, irregular clocks."""

from collections.abc import Callable
from dataclasses import asdict, dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
METRES_PER_RADIAN = 0.3  # noise and steps of slides, as a share of those of hinges


@dataclass(frozen=True)
class Sensors:
    """noise: standard deviation [rad]; step: encoder resolution [rad], 0 for none; jitter: of the clock's period.

    velocity_noise [rad/s] and force_noise (share of the force's root mean square) are None where not recorded.
    """

    noise: float
    step: float = 0.0
    jitter: float = 0.0
    velocity_noise: float | None = None
    force_noise: float | None = None

    def scale(self, model: mujoco.MjModel) -> Array:
        """Share [nv] of the noise that each degree of freedom gets."""
        share = np.ones(model.nv)
        for j in range(model.njnt):
            slide = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
            free = model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE
            dof = model.jnt_dofadr[j]
            share[dof : dof + (3 if free else 1)] = METRES_PER_RADIAN if slide or free else 1.0
        return share

    def floor(self, model: mujoco.MjModel) -> Array:
        """Standard deviation [nv] of a measured position, quantisation included."""
        return self.scale(model) * np.hypot(self.noise, self.step / np.sqrt(12))

    def reader(
        self, model: mujoco.MjModel, rng: np.random.Generator
    ) -> Callable[[Array, Array], tuple[Array, Array]]:
        """A function that measures a state: noise on the tangent space, then encoder steps (not on quaternions)."""
        scale = self.scale(model)
        single = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
        columns, steps = model.jnt_qposadr[single], self.step * scale[model.jnt_dofadr[single]]
        noise, velocity_noise = self.noise * scale, (self.velocity_noise or 0.0) * scale

        def read(qpos: Array, qvel: Array) -> tuple[Array, Array]:
            noisy = qpos.copy()
            mujoco.mj_integratePos(model, noisy, noise * rng.standard_normal(model.nv), 1.0)
            if self.step > 0:
                noisy[columns] = np.round(noisy[columns] / steps) * steps
            return noisy, qvel + velocity_noise * rng.standard_normal(model.nv)

        return read

    def read_force(self, force: Array, rng: np.random.Generator) -> Array:
        """Measured actuator forces [T, nu]."""
        rms = np.sqrt((force**2).mean(0)) + 1e-9
        return force + (self.force_noise or 0.0) * rms * rng.standard_normal(force.shape)

    def ticks(self, period: float, duration: float, dt: float, rng: np.random.Generator) -> NDArray[np.int64]:
        """Sub-steps [T] at which rows are taken: regular, or jittered with a few gaps."""
        regular = round(period / dt)
        n = round(duration / period)
        if self.jitter == 0:
            return np.arange(n) * regular
        gaps = np.maximum(
            np.round(regular * (1 + self.jitter * rng.standard_normal(n - 1))), max(1, regular // 3)
        )
        late = rng.random(n - 1) < 0.004
        gaps[late] += regular * rng.integers(1, 4, late.sum())
        return np.concatenate([[0], np.cumsum(gaps)]).astype(np.int64)

    def ways(self) -> list[str]:
        """How these sensors conceal the physics, in words."""
        words = [f"noise {self.noise:.1e} rad"]
        if self.step > 0:
            words.append(f"encoder steps of {self.step:.1e} rad")
        if self.jitter > 0:
            words.append("jittered clock")
        if self.velocity_noise is None:
            words.append("no velocities")
        return words

    def as_json(self) -> dict:
        """For the answer file."""
        return asdict(self)


def draw_sensors(rng: np.random.Generator, force: bool | None = None) -> Sensors:
    """Random sensors: noise 1e-5 to 2e-3 rad, a third quantised, half without velocities, a third jittered."""
    quantised = rng.random() < 0.33
    step = float(2 * np.pi / 2.0 ** rng.integers(12, 18)) if quantised else 0.0
    noise = float(np.exp(rng.uniform(np.log(1e-5), np.log(2e-3))))
    with_force = rng.random() < 0.4 if force is None else force
    return Sensors(
        noise=min(noise, 5e-4) if quantised else noise,
        step=step,
        jitter=float(rng.uniform(0.05, 0.2)) if rng.random() < 0.33 else 0.0,
        velocity_noise=float(np.exp(rng.uniform(np.log(3e-3), np.log(5e-2)))) if rng.random() < 0.5 else None,
        force_noise=float(rng.uniform(0.002, 0.01)) if with_force else None,
    )
