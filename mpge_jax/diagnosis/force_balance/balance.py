"""What the motion needs against what was measured, filtered alike: predictions and how they change."""

from __future__ import annotations

from dataclasses import dataclass

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
    _known: list[dict[Key, Rigid]]

    @staticmethod
    def of(
        ctx: Context, rows: list[Track], resolution: Resolution, known: list[dict[Key, Rigid]] | None = None
    ) -> Balance:
        """`rows`: of that resolution. known: inverse dynamics along the same motion, which are added to."""
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
            [{} for _ in rows] if known is None else known,
        )

    @staticmethod
    def recorded(p: Prepared, sources: tuple[Source, ...], most: int, resolution: Resolution) -> Balance:
        """Of some recordings, by at most `most` rows."""
        return Balance.of(p.ctx, tracks(p, sources, most, resolution), resolution)

    def predicted(self, parts: dict[Term, Array]) -> Array:
        """Forces [N, nu] that the motion needs, as the measurement would show them."""
        machine = Machine.build(self.ctx, tuple(parts), tuple(parts.values()))
        forces = [needed(machine, t, k) for t, k in zip(self.tracks, self._known, strict=True)]
        cutoff, lag = min(self.resolution.sensor, self.resolution.motion), self.resolution.lag
        seen = [
            low_pass(lagged(f, t.time, lag), t.time, cutoff) for f, t in zip(forces, self.tracks, strict=True)
        ]
        return np.concatenate(seen)

    def predicted_by(self, f: Fitted) -> Array:
        """The same of a fit."""
        return self.predicted(f.hypothesis.split(self.ctx, f.theta))

    def columns(self, parts: dict[Term, Array], term: Term, here: Array) -> Array:
        """Change [p, N, nu] of the predicted force with each parameter of one of the `parts`.

        Args:
            here: prediction with `parts`.
        """
        theta, out = parts[term], []
        for i, param in enumerate(term.params(self.ctx)):
            moved, h = theta.copy(), STEP * param.scale
            moved[i] += h if theta[i] + h <= param.high else -h
            out.append((self.predicted({**parts, term: moved}) - here) / (moved[i] - theta[i]))
        return np.array(out).reshape(-1, *here.shape)


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
