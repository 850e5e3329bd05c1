"""What encoders show of simulated machines: with offsets and delays, at the rows of the recordings."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.machine.joint_space import difference, integrate
from mpge_jax.diagnosis.simulation.runtime_effects import Group
from mpge_jax.diagnosis.simulation.trajectories import states_between
from mpge_jax.diagnosis.simulation.windows import Windows

Array = np.ndarray


@dataclass(frozen=True)
class Encoders:
    """Encoders of n simulations of windows.

    Attributes:
        window: [n] of each simulation. offset: [n, nv] by which they read too much. delay: [n, nv] s by which they show
            late what was.
    """

    model: mujoco.MjModel
    w: Windows
    window: Array
    offset: Array
    delay: Array

    @staticmethod
    def under(groups: list[Group], ctx: Context, w: Windows, window: Array) -> Encoders:
        """As the effects in `groups` make them."""
        offset, delay = np.zeros((2, window.size, ctx.model.nv))
        for g in groups:
            if g.term.effect.senses:
                dof = ctx.dof(g.term.place)
                o, d = g.term.effect.sense(g.theta)
                offset[g.rows, dof] += o
                delay[g.rows, dof] += d
        return Encoders(ctx.model, w, window, offset, delay)

    def act_on(self, batch: Batch, servos: tuple[int, ...]) -> None:
        """Let servos act on what is read in place of what is."""
        m = self.model
        for a in servos:
            off = self.offset[:, m.jnt_dofadr[m.actuator_trnid[a, 0]]]
            (rows,) = np.nonzero(off)
            if rows.size:
                bias = batch.expand("actuator_biasprm")
                bias[rows, a, 0] += bias[rows, a, 1] * m.actuator_gear[a, 0] * off[rows]

    def starts(self, shift: Array) -> tuple[Array, Array]:
        """Positions [n, nq] and velocities [n, nv] from which the simulations show what was recorded at the starts,
        moved by `shift` [n, 2 nv]."""
        m, w, window = self.model, self.w, self.window
        q0, v0 = w.q0[window].copy(), w.v0[window].copy()
        for dof, q, late in self._late():
            for s in np.unique(w.source[window[late]]):
                rows = late[w.source[window[late]] == s]
                at = w.start[window[rows]] + self.delay[rows, dof]
                q0[rows, q], v0[rows, dof] = w.sources[s].state_at(at, q, dof)
        return integrate(m, q0, shift[:, : m.nv] - self.offset), v0 + shift[:, m.nv :]

    def misses(self, q: Array, v: Array) -> Array:
        """What was recorded less what trajectories [K + 1, n, nq], [K + 1, n, nv] show: [n, N, 2 nv], positions then
        velocities, in joint space; NaN where nothing is compared."""
        m, w, window = self.model, self.w, self.window
        times, seen = w.times[window], w.seen[window]
        pq, pv = states_between(m, q, v, times, w.dt)
        early: list[tuple[int, Array, Array]] = []
        for dof, column, rows in self._late():
            t = times[rows] - self.delay[rows, dof, None]
            sq, sv = states_between(m, q[:, rows], v[:, rows], np.maximum(t, 0.0), w.dt)
            pq[rows, :, column], pv[rows, :, dof] = sq[..., column], sv[..., dof]
            early.append((dof, rows, t < 0))
        out = np.empty((window.size, times.shape[1], 2 * m.nv))
        out[..., : m.nv] = difference(m, pq, w.qpos[window]) - self.offset[:, None, :]
        out[..., m.nv :] = w.qvel[window] - pv
        out[~seen] = np.nan
        for dof, rows, before in early:
            # what a delayed sensor shows first lies before the window; the later samples count for those too
            later = seen[rows] & ~before
            weight = np.sqrt(seen[rows].sum(1) / np.maximum(later.sum(1), 1))
            for k in (dof, m.nv + dof):
                value = np.where(before, 0.0, out[rows, :, k] * weight[:, None])
                out[rows, :, k] = np.where(np.isfinite(out[rows, :, k]), value, np.nan)
        return out

    def _late(self) -> list[tuple[int, int, Array]]:
        """(degree of freedom, its column of qpos, simulations in which its encoder is late) of each that is in any."""
        m = self.model
        return [
            (int(dof), int(m.jnt_qposadr[m.dof_jntid[dof]]), np.flatnonzero(self.delay[:, dof] != 0))
            for dof in np.flatnonzero((self.delay != 0).any(0))
        ]
