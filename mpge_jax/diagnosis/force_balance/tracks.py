"""Recorded motion with the forces measured along it, row by row."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import minimum_filter1d
from scipy.special import erf

from mpge_jax.diagnosis.dataset.given_motion import EDGE
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.force_balance.low_pass import low_pass
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source

Array = np.ndarray
UNSEEN = 2.0
"""Deviations of a velocity up to which a joint is not seen to move."""
SLIDES = 0.1
"""Share of its usual speed from which on a joint surely slides: slower, it may creep before it does."""


@dataclass(frozen=True)
class Resolution:
    """How finely motion and force are known.

    Attributes:
        motion: Hz below which velocities and accelerations are taken from the recorded velocities (infinite: as the
        smoother has them). sensor: Hz to which measured forces follow sudden ones (infinite: all). lag: time constant
        (s) of a filter of first order behind which forces were recorded.
        still: share of its usual speed over which dry friction is taken to build up where forces are predicted.
        held: whether a measured force is held from its row to the next, as a computed one is, and not that of a moment.
    """

    motion: float = np.inf
    sensor: float = np.inf
    lag: float = 0.0
    still: float = 0.0
    held: bool = False


@dataclass(frozen=True)
class Track:
    """Rows of one recording.

    Attributes:
        time: [T] s. q: [T, nq]. v, a: [T, nv]. unsure: [T, nv] deviation of v as far as it tells the
        direction of dry friction. force: [T, nu] measured, before the gear (NaN: not measured).
    """

    name: str
    time: Array
    q: Array
    v: Array
    a: Array
    unsure: Array
    force: Array

    @cached_property
    def direction(self) -> Array:
        """Expectation [T, nv] of the sign of v."""
        return np.asarray(erf(self.v / (np.sqrt(2.0) * np.maximum(self.unsure, 1e-9))))

    @cached_property
    def step(self) -> float:
        """Seconds between rows."""
        return float(np.median(np.diff(self.time)))

    def slides(self, usual: Array, about: float = 0.0) -> Array:
        """Whether a joint [T, nv] surely slides: elsewhere dry friction holds it with any force up to its level.

        Args:
            usual: speed [nv]. about: time (s) before and after for which it must, too.
        """
        here = np.abs(self.v) > np.maximum(UNSEEN * self.unsure, SLIDES * usual)
        rows = round(about / self.step) if self.time.size > 1 else 0
        return np.asarray(minimum_filter1d(here.astype(np.int8), 2 * rows + 1, axis=0, mode="nearest") > 0)

    def sensed(self, column: int, dof: int, offset: float, delay: float) -> Track:
        """The same if what was recorded of a joint was off by `offset`, and `delay` s late."""
        q, v, a = self.q.copy(), self.v.copy(), self.a.copy()
        later = self.time + delay
        q[:, column] = np.interp(later, self.time, self.q[:, column]) - offset
        v[:, dof], a[:, dof] = (np.interp(later, self.time, x[:, dof]) for x in (self.v, self.a))
        return replace(self, q=q, v=v, a=a)


def tracks(
    p: Prepared, sources: tuple[Source, ...], most: int, resolution: Resolution = Resolution()
) -> list[Track]:
    """All recordings, at every row or at evenly spread ones so that there are at most `most`."""
    total = sum(s.recording.time.size - _first(s) - EDGE for s in sources)
    stride = max(1, int(np.ceil(total / most)))
    return [_track(p, s, stride, resolution) for s in sources]


def _first(s: Source) -> int:
    """The first row of a recording that is shown and whose acceleration is known well."""
    return max(EDGE, s.recording.first_shown)


def _track(p: Prepared, s: Source, stride: int, resolution: Resolution) -> Track:
    rows = slice(_first(s), s.recording.time.size - EDGE, stride)
    x, r = s.states, s.recording
    v, a, unsure = x.qvel, x.qacc, np.sqrt(np.maximum(x.cov[..., 1, 1], 0.0))
    unsure = np.maximum(unsure, resolution.still * p.ctx.speed)
    if np.isfinite(resolution.motion):
        v = low_pass(_raw_velocity(p, s), r.time, resolution.motion)
        a = np.gradient(v, r.time, axis=0)
    force = _force(p, s, resolution.held)
    return Track(r.name, r.time[rows], x.qpos[rows], v[rows], a[rows], unsure[rows], force[rows])


def _raw_velocity(p: Prepared, s: Source) -> Array:
    """Velocities [T, nv] as recorded, or differences of positions where none were, or none that can be used."""
    r, dofs = s.recording, p.model.jnt_dofadr
    out = np.empty_like(s.states.qvel)
    out[:, dofs] = np.gradient(r.qpos[:, p.model.jnt_qposadr], r.time, axis=0)
    if r.qvel is not None:
        good = np.isfinite(p.noise.qvel) & np.isfinite(r.qvel).all(0)
        out[:, good] = r.qvel[:, good]
    return out


def _force(p: Prepared, s: Source, held: bool) -> Array:
    """Measured force [T, nu] that belongs to the acceleration of each row; NaN where there is none."""
    force = np.where(p.measured, s.command, np.nan)
    if held:
        # the motion at a row is that of the intervals before and after it
        force[1:] = 0.5 * (force[1:] + force[:-1])
    return force
