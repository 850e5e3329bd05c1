"""What the motion needs against what was measured, filtered alike: predictions and how they change."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.evidence.folds import folds
from mpge_jax.diagnosis.force_balance.low_pass import lagged, low_pass
from mpge_jax.diagnosis.force_balance.needed_force import Key, Rigid, needed
from mpge_jax.diagnosis.force_balance.tracks import Resolution, Track, tracks
from mpge_jax.diagnosis.machine.model import is_joint_transmission
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source
from mpge_jax.diagnosis.simulation.single_step import Machine

Array = np.ndarray
BLOCKS = 40
"""Stretches of time into which the training recordings are cut: errors within one are alike, those of two are not."""
STEP = 0.05
"""Step of finite differences, in the scale of a parameter."""


@dataclass(frozen=True)
class Along:
    """What was computed along one motion, for whoever asks again.

    Attributes:
        rigid: inverse dynamics of each recording. changes: by effect and parameters, what `Balance.changes` gives.
    """

    rigid: list[dict[Key, Rigid]]
    changes: dict[tuple[Term, bytes], Array]

    @staticmethod
    def nothing(recordings: int) -> Along:
        return Along([{} for _ in range(recordings)], {})


@dataclass(frozen=True)
class Balance:
    """Recordings as equations of force.

    Attributes:
        tracks: rows of every recording.
        measured: [N, nu] forces of all of them (NaN: none), below the motion's frequency.
        telling: [N, nu] those that say what acts: where the joint slides that the actuator drives, or never does; dry
        friction holds it elsewhere with any force up to its level.
        block: [N] number of each row's block.
        fold: [B] part to which each block belongs (`folds`).
    """

    ctx: Context
    tracks: list[Track]
    measured: Array
    telling: Array
    block: Array
    fold: Array
    resolution: Resolution
    _known: Along

    @staticmethod
    def of(ctx: Context, rows: list[Track], resolution: Resolution, known: Along | None = None) -> Balance:
        """`rows`: of that resolution. known: of the same motion, which is as sure; it is added to."""
        total = sum(t.time[-1] - t.time[0] for t in rows)
        block, of, first = [], [], 0
        for k, t in enumerate(rows):
            count = max(1, round(BLOCKS * (t.time[-1] - t.time[0]) / max(total, 1e-12)))
            block.append(first + np.minimum(np.arange(t.time.size) * count // t.time.size, count - 1))
            first += count
            of += [k] * count
        measured = np.concatenate([_seen(t.force, t.time, resolution.motion) for t in rows])
        slides = np.concatenate([t.slides(ctx.speed, 0.5 / resolution.motion) for t in rows])
        return Balance(
            ctx,
            rows,
            measured,
            np.where(_tells(ctx, slides), measured, np.nan),
            np.concatenate(block),
            folds(np.array(of), np.arange(first)),
            resolution,
            Along.nothing(len(rows)) if known is None else known,
        )

    @staticmethod
    def recorded(
        p: Prepared,
        sources: tuple[Source, ...],
        most: int,
        resolution: Resolution,
        known: Along | None = None,
    ) -> Balance:
        """Of some recordings, by at most `most` rows."""
        return Balance.of(p.ctx, tracks(p, sources, most, resolution), resolution, known)

    def predicted(self, parts: dict[Term, Array]) -> Array:
        """Forces [N, nu] that the motion needs, as the measurement would show them."""
        return self.as_measured(self._needed(parts))

    def predicted_by(self, f: Fitted) -> Array:
        """The same of a fit."""
        return self.predicted(f.hypothesis.split(self.ctx, f.theta))

    def as_measured(self, forces: Array) -> Array:
        """Forces [..., N, nu] through the filters of the measurement."""
        cutoff, lag = min(self.resolution.sensor, self.resolution.motion), self.resolution.lag
        out, at = np.empty_like(forces), 0
        for t in self.tracks:
            rows = slice(at, at + t.time.size)
            here = np.moveaxis(forces[..., rows, :], -2, 0)
            out[..., rows, :] = np.moveaxis(low_pass(lagged(here, t.time, lag), t.time, cutoff), 0, -2)
            at = rows.stop
        return out

    def changes(self, term: Term, start: Array) -> Array:
        """Change [1 + p, N, nu] of the needed force, not as measured, by one effect, and with each of its parameters
        there."""
        key = term, start.tobytes()
        if key not in self._known.changes:
            parts = {term: start}
            here, (moved, by) = self._needed(parts), self._moved(parts, term)
            self._known.changes[key] = np.concatenate([(here - self._as_given)[None], (moved - here) / by])
        return self._known.changes[key]

    def columns(self, parts: dict[Term, Array], term: Term, here: Array) -> Array:
        """Change [p, N, nu] of the predicted force with each parameter of one of the `parts`.

        Args:
            here: prediction with `parts`.
        """
        moved, by = self._moved(parts, term)
        return (self.as_measured(moved) - here) / by

    @cached_property
    def _as_given(self) -> Array:
        return self._needed({})

    def _needed(self, parts: dict[Term, Array]) -> Array:
        """Forces [N, nu] that the motion needs, as they are."""
        machine = Machine.build(self.ctx, tuple(parts), tuple(parts.values()))
        return np.concatenate(
            [needed(machine, t, k) for t, k in zip(self.tracks, self._known.rigid, strict=True)]
        )

    def _moved(self, parts: dict[Term, Array], term: Term) -> tuple[Array, Array]:
        """Needed forces [p, N, nu] with each parameter of one of the `parts` moved, and by how much [p, 1, 1]."""
        theta, params = parts[term], term.params(self.ctx)
        out, by = np.empty((len(params), *self.measured.shape)), np.empty((len(params), 1, 1))
        for i, param in enumerate(params):
            moved, h = theta.copy(), STEP * param.scale
            moved[i] += h if theta[i] + h <= param.high else -h
            out[i], by[i] = self._needed({**parts, term: moved}), moved[i] - theta[i]
        return out, by


def _tells(ctx: Context, slides: Array) -> Array:
    """Whether the joint slides [N, nu] that an actuator drives; true throughout where it never does.

    Args:
        slides: [N, nv].
    """
    m, out = ctx.model, np.ones((len(slides), ctx.model.nu), bool)
    for a in range(m.nu):
        if is_joint_transmission(m, a):
            here = slides[:, m.jnt_dofadr[m.actuator_trnid[a, 0]]]
            out[:, a] = here | ~here.any()
    return out


def _seen(force: Array, time: Array, cutoff: float) -> Array:
    known = np.isfinite(force).all(0)
    out = force.copy()
    out[:, known] = low_pass(force[:, known], time, cutoff)
    return out
