"""Errors of the forces that a recorded motion needs, in the model as given and in the corrected one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.force_balance.balance import Balance
from mpge_jax.diagnosis.force_balance.tracks import Resolution
from mpge_jax.diagnosis.recordings.noise_level import column_noise
from mpge_jax.diagnosis.recordings.states import estimate
from mpge_jax.diagnosis.simulation.driving.drive_signal import Source

Array = np.ndarray
ROWS = 6000
"""Most rows that are predicted, over all recordings together."""


@dataclass(frozen=True)
class ForceErrors:
    """Predicted actuator forces of some recordings beside what was measured; errors are root mean squares.

    Attributes:
        given, corrected: [N, nu] predicted by either model. floors: [nu] errors that noise alone leaves. floors_left:
        [nu] of them, where the joints move.
    """

    balance: Balance
    given: Array
    corrected: Array
    floors: Array
    floors_left: Array

    @property
    def before(self) -> float:
        return self._rms(self.given)

    @property
    def after(self) -> float:
        return self._rms(self.corrected)

    @property
    def floor(self) -> float:
        seen = np.isfinite(self.floors)
        return float(np.sqrt((self.floors[seen] ** 2).mean()))

    @property
    def each_before(self) -> Array:
        """[nu]; NaN where no force was measured."""
        return rms(self.given - self.balance.measured)

    @property
    def each_after(self) -> Array:
        return rms(self.corrected - self.balance.measured)

    @property
    def each_left(self) -> Array:
        """[nu] where the joints move."""
        return rms(self.corrected - self.balance.telling)

    @property
    def size(self) -> Array:
        """Root mean square [nu] of the measured forces."""
        return rms(self.balance.measured)

    def of(self, f: Fitted) -> float:
        """Error of another fit."""
        return self._rms(self.balance.predicted_by(f))

    def _rms(self, predicted: Array) -> float:
        wrong = predicted - self.balance.measured
        return float(np.sqrt(np.nanmean(wrong**2)))


def force_errors(p: Prepared, sources: tuple[Source, ...], resolution: Resolution, f: Fitted) -> ForceErrors:
    """Errors over some recordings."""
    return errors_of(p, sources, Balance.recorded(p, sources, ROWS, resolution), f)


def errors_of(p: Prepared, sources: tuple[Source, ...], b: Balance, f: Fitted) -> ForceErrors:
    """The same where their balance is known."""
    corrected = b.predicted_by(f)
    return ForceErrors(b, b.predicted({}), corrected, *_floors(p, sources, b, f, corrected))


def rms(x: Array) -> Array:
    """Root mean square [nu] of rows [N, nu] (NaN: not measured)."""
    count = np.isfinite(x).sum(0)
    return np.where(count > 0, np.sqrt(np.nansum(x**2, 0) / np.maximum(count, 1)), np.nan)


def _floors(
    p: Prepared, sources: tuple[Source, ...], b: Balance, f: Fitted, corrected: Array
) -> tuple[Array, Array]:
    """Errors [nu] that noise alone leaves, in all and where the joints move: by how much the prediction moves where the
    motion is recorded once more, and what is left of the noise of the measured forces."""
    rng = np.random.default_rng(p.config.seed)
    sensor = _sensor_noise(p)
    again = tuple(_recorded_again(p, s, sensor, np.isfinite(b.resolution.motion), rng) for s in sources)
    other = Balance.recorded(p, again, ROWS, b.resolution)
    moved = other.predicted_by(f) - corrected
    alone = rms(other.measured)
    everywhere, moving = (
        np.sqrt(rms(np.where(np.isfinite(x), moved, np.nan)) ** 2 + alone**2) for x in (b.measured, b.telling)
    )
    return everywhere, moving


def _recorded_again(
    p: Prepared, source: Source, sensor: Array, filtered: bool, rng: np.random.Generator
) -> Source:
    """The smoothed motion as if it were the true one, with noise; and of the forces their noise alone. What smoothing
    takes from a motion is so counted with what noise adds.

    Args:
        filtered: whether the motion is that of recorded velocities below a frequency, and not the smoother's.
    """
    r, x = source.recording, source.states

    def noise(level: Array, shape: tuple[int, ...]) -> Any:
        return np.where(np.isfinite(level), level, 0.0) * rng.standard_normal(shape)

    q, v = (r.qpos, r.qvel) if filtered else (x.qpos, None if r.qvel is None else x.qvel)
    qvel = None if v is None else v + noise(p.noise.qvel, v.shape)
    recording = replace(r, qpos=q + noise(p.noise.qpos, q.shape), qvel=qvel)
    states = estimate([recording], p.model, p.names)[1][0]
    return Source.build(recording, states, noise(sensor, source.command.shape))


def _sensor_noise(p: Prepared) -> Array:
    """Deviation [nu] of the measured forces' noise (NaN: not measured)."""
    recordings = [s.recording for s in p.looked_at]
    out = np.full(p.model.nu, np.nan)
    for a in np.flatnonzero(p.measured):
        level, _ = column_noise([r.time for r in recordings], [r.known("force")[:, a] for r in recordings])
        out[a] = level if np.isfinite(level) else 0.0
    return out
