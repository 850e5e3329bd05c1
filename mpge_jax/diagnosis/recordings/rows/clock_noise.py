"""How exactly rows are stamped with the time at which they were measured: where a stamp is off, a position is off by as
much times its speed."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.recordings.noise_level import MAD, ORDERS, difference_noise, speed_around

Array = np.ndarray
ALIKE = 1.2
"""By how much what differences of several orders tell of noise may differ."""
BINS = 6
"""Groups of rows of like speed."""
ROWS = 40
"""Rows of a group, at least."""
RESTING = 1e-4
"""Share of the largest variance below which one is none."""
SURE = 4.0
"""Deviations by which noise must grow with the speed."""


def stamp_deviation(times: list[Array], columns: list[list[Array]]) -> float:
    """Standard deviation (s) of the time stamps: by how the noise of positions grows with their speed, in all columns
    alike. 0 where that is not beyond doubt.

    Fast motion that rows do not resolve looks alike, but not in differences of every order.

    Args:
        columns: of each column its positions [T] in every recording.
    """
    found = np.sqrt([_by_order(times, columns, order) for order in ORDERS])
    return float(found.mean()) if found.max() <= ALIKE * found.min() else 0.0


def _by_order(times: list[Array], columns: list[list[Array]], order: int) -> float:
    """The variance (s^2), by differences of one order; 0 where it is not beyond doubt."""
    slopes = [s for values in columns if (s := _growth(times, values, order)) is not None]
    if not slopes:
        return 0.0
    slope, error = np.array(slopes).T
    weight = error**-2.0
    mean = float((weight * slope).sum() / weight.sum())
    # where columns disagree by more than they may, it is something else that grows with the speed
    disagree = (weight * (slope - mean) ** 2).sum() / max(len(slopes) - 1, 1)
    unsure = np.sqrt(max(disagree, 1.0) / weight.sum())
    return mean if mean > SURE * unsure else 0.0


def _growth(times: list[Array], values: list[Array], order: int) -> tuple[float, float] | None:
    """By how much the variance of one column's noise grows with the square of its speed, and the standard error of
    that; None where the column hardly moves or is short."""
    noise, speed = [], []
    for t, x in zip(times, values, strict=True):
        t, x = t[np.isfinite(x)], x[np.isfinite(x)]
        if x.size > order + 2:
            noise.append(difference_noise(t, x, order)[1:-1])
            speed.append(speed_around(t, x, order) ** 2)
    if not noise:
        return None
    d, square = np.concatenate(noise), np.concatenate(speed)
    groups = [g for g in np.array_split(np.argsort(square), BINS) if g.size >= ROWS]
    if len(groups) < BINS:
        return None
    variance = np.array([(MAD * np.median(np.abs(d[g]))) ** 2 for g in groups])
    at = np.array([square[g].mean() for g in groups])
    # a quantised encoder has no noise at rest
    if variance.min() < RESTING * variance.max() or np.ptp(at) <= 0:
        return None
    # a median's square is off by 2.3 / sqrt(n) of itself; neighbouring differences share rows
    error = variance * 2.3 * np.sqrt((order + 1) / np.array([g.size for g in groups]))
    design = np.stack([np.ones_like(at), at / at.max()], 1) / error[:, None]
    cov = np.linalg.inv(design.T @ design)
    slope = (cov @ design.T @ (variance / error))[1] / at.max()
    return float(slope), float(np.sqrt(cov[1, 1]) / at.max())
