"""What windows answer to short pulses of force on a joint, one after the other: with these, what any function that acts
there would change, without a simulation for each of its values."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Place
from mpge_jax.diagnosis.effects.residual.force import Residual
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.missing_force import slight_forces
from mpge_jax.diagnosis.estimation.whitening import Whitener
from mpge_jax.diagnosis.residual.inputs import values_within
from mpge_jax.diagnosis.residual.regression import Blocks
from mpge_jax.diagnosis.simulation.batch_simulator import Run
from mpge_jax.diagnosis.simulation.cheaper_steps import Near
from mpge_jax.diagnosis.simulation.pushes import Push
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray
PULSES = 20
"""Pulses along a window."""
TIMES = 3
"""Times within each pulse at which functions are evaluated."""


@dataclass(frozen=True)
class Pulses:
    """B windows of a fit and what pulses at a joint change of them.

    Attributes:
        left: [B, N, 2 nv] what the fit leaves. pushed: [PULSES, B, N, 2 nv] that with each of the pulses. force: of
            these, in N or N m.
        values: of every input (`Axis.key`), as it was measured, within the pulses: [B, PULSES, TIMES].
    """

    left: Array
    pushed: Array
    force: float
    values: dict[str, Array]

    @staticmethod
    def at(p: Prepared, f: Fitted, place: Place, w: Windows) -> Pulses:
        """Simulate the windows of `f` without and with each pulse at a joint."""
        dof, edges = p.ctx.dof(place), np.linspace(0.0, 1.0, PULSES + 1).tolist()
        # as much as a push along the whole window
        force = PULSES * float(slight_forces(p.ctx)[dof])
        pushes = [None, *(Push(dof, force, *part) for part in pairwise(edges))]
        runs = [Run(f.hypothesis, f.theta, push=push) for push in pushes]
        left, *pushed = Near.to(p.sim, runs[0], w).residuals(runs)
        within = w.steps * w.dt * (np.arange(PULSES * TIMES) + 0.5) / (PULSES * TIMES)
        values = {key: x.reshape(-1, PULSES, TIMES) for key, x in values_within(p, w, place, within).items()}
        return Pulses(left, np.array(pushed), force, values)

    def seen_by(self, white: Whitener, weight: Array) -> Answers:
        """The same in units of noise.

        Args:
            weight: [B] of the windows.
        """
        left = white(self.left)
        answers = (white(self.pushed) - left) / self.force
        return Answers(Blocks.of(answers, left, weight), self.values)


@dataclass(frozen=True)
class Answers:
    """Least squares of the forces of `Pulses` [PULSES], and of all that follows from these."""

    forces: Blocks
    values: dict[str, Array]

    def of(self, effect: Residual) -> Blocks:
        """The least-squares problem of a function's values, near nothing."""
        b, some = self.forces, [self.values[a.key] for a in effect.axes]
        basis = (np.array(effect.basis(np, some)) * effect.against(self.values)).mean(-1)
        half = np.einsum("bts,qbs->btq", b.gram, basis, optimize=True)
        gram = np.einsum("pbt,btq->bpq", basis, half, optimize=True)
        return Blocks(gram, np.einsum("pbt,bt->bp", basis, b.push, optimize=True), b.whole, b.weight)
