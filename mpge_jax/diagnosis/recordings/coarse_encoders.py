"""Coarse encoders: how far the rounding of a reading is shared by those beside it, and says nothing new."""

from __future__ import annotations

import numpy as np

Array = np.ndarray
REACH = 100
"""Rows on either side that may share the rounding of one."""
AVERAGED = 5
"""Rows whose mean tells where the machine is, for that."""


def held_error(position: Array, step: float, sigma: float) -> Array:
    """Deviation [T] that readings have beyond `sigma`, so that as many as share their rounding weigh as one does.

    Rounding errs by step / sqrt(12); while the machine moves by less than half a step all readings err alike. White
    noise of deviation w beneath the steps blurs that: exp(-2 pi^2 w^2 / step^2) of it is left (the first harmonic of
    the mean rounding error by position; Widrow and Kollar, Quantization Noise, 2008).

    Args:
        position: [T] as read. step: of the encoder, 0 for none. sigma: deviation of single readings, rounding included.
    """
    rows = position.size
    if step <= 0.0 or rows < AVERAGED:
        return np.zeros(rows)
    white = max(sigma**2 - step**2 / 12.0, 0.0)
    shared = step / np.sqrt(12.0) * np.exp(-2.0 * np.pi**2 * white / step**2)
    padded = np.pad(position, AVERAGED // 2, mode="edge")
    where = np.convolve(padded, np.full(AVERAGED, 1.0 / AVERAGED), "valid")
    count = np.ones(rows)
    for x, counted in ((where, count), (where[::-1], count[::-1])):
        near = np.ones(rows, bool)
        for lag in range(1, min(REACH, rows - 1) + 1):
            near[:-lag] &= np.abs(x[lag:] - x[:-lag]) < 0.5 * step
            near[rows - lag :] = False
            if not near.any():
                break
            counted += near
    return shared * np.sqrt(count - 1.0)
