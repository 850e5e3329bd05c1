"""States with uncertainty from noisy positions: a Kalman filter and Rauch-Tung-Striebel smoother per column.

The motion model is white jerk (state: position, velocity, acceleration) on the actual sample times; its
intensity is chosen per stretch of recording by maximum likelihood. All stretches and columns run as one batch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Array = np.ndarray
CHUNK, OVERLAP = 50, 25
INTENSITIES = 10.0 ** np.arange(-3, 11)
PAUSE = 5.0
"""Seconds without rows after which next to nothing is known of the state; longer ones cost digits of the covariance."""


@dataclass(frozen=True)
class Smoothed:
    """Smoothed states of one series.

    Attributes:
        mean: [T, 3] position, velocity, acceleration.
        cov: [T, 3, 3] their covariance.
        intensity: [T] of the jerk.
        likelihood: logarithm of the measurements' one, nan where intensities were given.
    """

    mean: Array
    cov: Array
    intensity: Array
    likelihood: float


def _transition(dt: Array) -> tuple[Array, Array]:
    """Transition [..., 3, 3] and unit-intensity process noise of white jerk over `dt` [...]."""
    one, zero = np.ones_like(dt), np.zeros_like(dt)
    f = np.stack([one, dt, dt**2 / 2, zero, one, dt, zero, zero, one], -1).reshape(*dt.shape, 3, 3)
    q = np.stack(
        [dt**5 / 20, dt**4 / 8, dt**3 / 6, dt**4 / 8, dt**3 / 3, dt**2 / 2, dt**3 / 6, dt**2 / 2, dt], -1
    ).reshape(*dt.shape, 3, 3)
    return f, q


def _filter(dt: Array, y: Array, r: Array, intensity: Array, keep: bool) -> tuple[Array, list[Array]]:
    """Filter a batch.

    Args:
        dt: [L-1, B] steps. y: [L, B, 2] position and velocity measurements (NaN: none).
        r: [L, B, 2] measurement variances. intensity: [B, G] jerk intensities.
        keep: whether to return the filtered and predicted moments.
    """
    length, batch = y.shape[:2]
    grid = intensity.shape[1]
    mean = np.zeros((3, batch, grid))
    mean[0] = np.nan_to_num(y[0, :, 0])[:, None]
    cov = np.zeros((3, 3, batch, grid))
    spread = np.nanvar(y[..., 0], axis=0) + r[..., 0].max(0)
    # a wide start: the first velocity and acceleration are unknown
    cov[0, 0] = 1e2 * (spread + 1e-8)[:, None]
    cov[1, 1] = 1e4
    cov[2, 2] = 1e6
    loglik = np.zeros((batch, grid))
    history: list[list[Array]] = [[], [], [], []]
    noise = np.moveaxis(_transition(dt)[1], 1, -1)[..., None]
    for t in range(length):
        if t:
            step = dt[t - 1][:, None]
            mean = _onward(mean, step)
            cov = np.swapaxes(_onward(np.swapaxes(_onward(cov, step), 0, 1), step), 0, 1)
            cov += noise[t - 1] * intensity
        mean_p, cov_p = mean, cov
        for k in (0, 1):
            z = y[t, :, k, None]
            seen = np.isfinite(z)
            if not seen.any():
                continue
            innovation = np.where(seen, z, 0.0) - mean[k]
            s = cov[k, k] + r[t, :, k, None]
            gain = np.where(seen, cov[:, k] / s, 0.0)
            mean = mean + gain * innovation
            cov = cov - gain[:, None] * cov[k]
            cov = 0.5 * (cov + np.swapaxes(cov, 0, 1))
            if t >= 4:
                loglik += np.where(seen, -0.5 * (np.log(s) + innovation**2 / s), 0.0)
        if keep:
            for store, value in zip(history, (mean_p, cov_p, mean, cov), strict=True):
                store.append(value)
    kept = [np.array(h) for h in history] if keep else []
    return loglik, [np.moveaxis(h, (-2, -1), (1, 2)) for h in kept]


def _onward(x: Array, dt: Array) -> Array:
    """Positions, velocities and accelerations [3, ...] a step later, where these stay."""
    velocity = x[1] + dt * x[2]
    return np.stack([x[0] + dt * (0.5 * (x[1] + velocity)), velocity, x[2]])


def _smooth(dt: Array, moments: list[Array]) -> tuple[Array, Array]:
    mean_p, cov_p, mean, cov = moments
    f_all, _ = _transition(dt)
    out_m, out_c = mean.copy(), cov.copy()
    for t in range(len(mean) - 2, -1, -1):
        f = f_all[t][:, None]
        scale = 1.0 / np.sqrt(np.maximum(np.einsum("...ii->...i", cov_p[t + 1]), 1e-300))
        scaled = cov_p[t + 1] * scale[..., :, None] * scale[..., None, :] + 1e-12 * np.eye(3)
        inverse = np.linalg.inv(scaled) * scale[..., :, None] * scale[..., None, :]
        gain = cov[t] @ np.swapaxes(f, -1, -2) @ inverse
        out_m[t] = mean[t] + (gain @ (out_m[t + 1] - mean_p[t + 1])[..., None])[..., 0]
        c = cov[t] + gain @ (out_c[t + 1] - cov_p[t + 1]) @ np.swapaxes(gain, -1, -2)
        out_c[t] = 0.5 * (c + np.swapaxes(c, -1, -2))
        for k in range(3):  # rounding must not leave a variance at or below zero
            out_c[t][..., k, k] = np.maximum(out_c[t][..., k, k], 1e-6 * cov[t][..., k, k])
    return out_m, out_c


@dataclass(frozen=True)
class Series:
    """One column to smooth: times [T], positions [T], velocities [T] or None, deviations of both ([T] of positions)."""

    time: Array
    position: Array
    velocity: Array | None
    sigma: Array
    sigma_velocity: float


def smooth(series: list[Series], intensity: list[Array] | None = None) -> list[Smoothed]:
    """Smooth every series; stretches of `CHUNK` rows with overlap run as one batch.

    Args:
        intensity: [T] of the jerk of each, if it is known.
    """
    pieces = []  # (series, first row, last row, first kept, last kept)
    for i, s in enumerate(series):
        n = s.time.size
        for start in range(0, n, CHUNK):
            a, b = max(0, start - OVERLAP), min(n, start + CHUNK + OVERLAP)
            pieces.append((i, a, b, start, min(n, start + CHUNK)))
    length = max(b - a for _, a, b, _, _ in pieces)
    batch = len(pieces)
    dt = np.full((max(length - 1, 1), batch), 1e-3)
    y = np.full((length, batch, 2), np.nan)
    r = np.ones((length, batch, 2))
    for k, (i, a, b, _, _) in enumerate(pieces):
        s = series[i]
        dt[: b - a - 1, k] = np.minimum(np.diff(s.time[a:b]), PAUSE)
        y[: b - a, k, 0] = s.position[a:b] - s.position[a]
        if s.velocity is not None:
            y[: b - a, k, 1] = s.velocity[a:b]
        r[: b - a, k, 0], r[:, k, 1] = s.sigma[a:b] ** 2, s.sigma_velocity**2
    if intensity is None:
        loglik, _ = _filter(dt, y, r, np.tile(INTENSITIES, (batch, 1)), keep=False)
        owner = np.array([p[0] for p in pieces])
        pooled = np.array([loglik[owner == owner[k]].mean(0) for k in range(batch)])
        likeliest = np.argmax(loglik + 0.1 * pooled, axis=1)
        best, reached = INTENSITIES[likeliest], np.take_along_axis(loglik, likeliest[:, None], 1)[:, 0]
        likelihood = np.bincount(owner, reached, minlength=len(series))
    else:
        likelihood = np.full(len(series), np.nan)
        best = np.array([intensity[i][first] for i, _, _, first, _ in pieces])
    _, moments = _filter(dt, y, r, best[:, None], keep=True)
    mean, cov = _smooth(dt, moments)
    sizes = [s.time.size for s in series]
    out = [
        Smoothed(np.empty((n, 3)), np.empty((n, 3, 3)), np.empty(n), float(x))
        for n, x in zip(sizes, likelihood, strict=True)
    ]
    for k, (i, a, _, first, last) in enumerate(pieces):
        m = mean[first - a : last - a, k, 0].copy()
        m[:, 0] += series[i].position[a]
        out[i].mean[first:last] = m
        out[i].cov[first:last] = cov[first - a : last - a, k, 0]
        out[i].intensity[first:last] = best[k]
    return out


def errors_drawn(series: list[Series], count: int, rng: np.random.Generator) -> list[Array]:
    """Of every series by how much [count, T, 3] its motion may differ from the smoothed one: draws.

    Durbin and Koopman (2002): smoothing errs as much where any motion of the model is measured alike.
    """
    walks, again, intensity = list[Array](), list[Series](), list[Array]()
    for s, told in zip(series, smooth(series), strict=True):
        f, q = _transition(np.minimum(np.diff(s.time), PAUSE))
        shocks = np.linalg.cholesky(q)[:, None] @ rng.standard_normal((s.time.size - 1, count, 3, 1))
        walk = np.zeros((s.time.size, count, 3))
        for t, shock in enumerate(shocks[..., 0]):
            walk[t + 1] = walk[t] @ f[t].T + np.sqrt(told.intensity[t + 1]) * shock
        for x in np.swapaxes(walk, 0, 1):
            position = x[:, 0] + s.sigma * rng.standard_normal(s.time.size)
            velocity = x[:, 1] + s.sigma_velocity * rng.standard_normal(s.time.size)
            again.append(replace(s, position=position, velocity=None if s.velocity is None else velocity))
            intensity.append(told.intensity)
            walks.append(x)
    errors = [x - y.mean for x, y in zip(walks, smooth(again, intensity), strict=True)]
    return [np.array(errors[k : k + count]) for k in range(0, len(errors), count)]
