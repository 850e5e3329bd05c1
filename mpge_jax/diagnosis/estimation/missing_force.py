"""Force that a fit lacks, estimated window by window at every degree of freedom."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.whitening import Whitener, whitener
from mpge_jax.diagnosis.machine.model import floating_base_joints
from mpge_jax.diagnosis.recordings.measurement_noise import Noise
from mpge_jax.diagnosis.simulation.batch_simulator import Run, Simulator
from mpge_jax.diagnosis.simulation.cheaper_steps import Near
from mpge_jax.diagnosis.simulation.pushes import Push
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
PUSH = 0.02
"""Force, in the machine's typical ones, by which the answer to forces is told."""


@dataclass(frozen=True)
class Probed:
    """What constant generalised forces would do to windows, and what the windows show of them: the least-squares
    problem of the force that is missing in each, in units of `scale`.

    Attributes:
        gram: [W, nv, nv]. push: [W, nv] what the forces meet of whitened residuals. scale: [nv] forces that probed.
    """

    gram: Array
    push: Array
    scale: Array

    def by_dof(self) -> tuple[Array, Array]:
        """How much force is missing at each degree of freedom: (ratio [nv], force estimates [W, nv]).

        In every window a constant generalised force is estimated from the whitened residual; its square over its
        variance, averaged over windows, is one when noise alone acts.
        """
        inverse = self._inverse()
        estimate = np.einsum("wij,wj->wi", inverse, self.push)
        variance = np.maximum(np.einsum("wii->wi", inverse), 1e-300)
        ratio = np.minimum(estimate**2 / variance, 1e6)
        return ratio.mean(0), estimate * self.scale

    def unsure(self) -> Array:
        """Standard errors [W, nv] of the force estimates of `by_dof`."""
        return np.sqrt(np.maximum(np.einsum("wii->wi", self._inverse()), 0.0)) * self.scale

    def _inverse(self) -> Array:
        return np.linalg.pinv(self.gram, rcond=1e-10, hermitian=True)

    def along(self, directions: Array) -> tuple[Array, Array]:
        """chi^2 of every window that missing force along each direction alone explains [W, k], and that missing force
        of any direction does [W].

        Args:
            directions: [W, k, nv] generalised forces; their length does not matter.
        """
        inverse = self._inverse()
        whole = np.einsum("wi,wij,wj->w", self.push, inverse, self.push)
        unit = directions / self.scale
        along = np.einsum("wki,wi->wk", unit, self.push) ** 2
        cost = np.einsum("wki,wij,wkj->wk", unit, self.gram, unit)
        return along / np.maximum(cost, 1e-300), whole


def slight_forces(ctx: Context) -> Array:
    """Forces [nv] that are small beside the machine's own."""
    return np.asarray(PUSH * np.maximum(ctx.torque, 1e-9))


def pushes(sim: Simulator, f: Fitted, dofs: Iterable[int]) -> tuple[Array, list[Run]]:
    """Slight forces [nv], and the runs of `f` without them and with each of some."""
    scale = slight_forces(sim.ctx)
    pushed = [Run(f.hypothesis, f.theta, push=Push(d, float(scale[d]))) for d in dofs]
    return scale, [Run(f.hypothesis, f.theta), *pushed]


def probed(sim: Simulator, f: Fitted, w: Windows, white: Whitener) -> Probed:
    """Windows probed by a small push at every degree of freedom."""
    nv, (scale, runs) = sim.model.nv, pushes(sim, f, range(sim.model.nv))
    flat = white(Near.to(sim, runs[0], w).residuals(runs))
    columns = np.moveaxis(flat[1:] - flat[0], 0, -1)  # [W, M, nv]
    gram = np.einsum("wmi,wmj->wij", columns, columns) + 1e-12 * np.eye(nv)
    return Probed(gram, -np.einsum("wmi,wm->wi", columns, flat[0]), scale)


def missing(sim: Simulator, f: Fitted, w: Windows, noise: Noise) -> tuple[Array, Array]:
    """The constant force that every window lacks at every degree of freedom, and its standard error, [W, nv] each."""
    found = probed(sim, f, w, whitener(sim, f.hypothesis, f.theta, w, noise, temper=False))
    return found.by_dof()[1], found.unsure()


def excess_by_dof(sim: Simulator, f: Fitted, w: Windows, white: Whitener) -> tuple[Array, Array]:
    """`Probed.by_dof` of windows."""
    return probed(sim, f, w, white).by_dof()


def active_dofs(model: mujoco.MjModel) -> list[int]:
    base = floating_base_joints(model)
    return [d for d in range(model.nv) if int(model.dof_jntid[d]) not in base]
