"""Low-pass filters for rows at uneven times: one without phase, and one that lags behind."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

# `scipy.signal` takes longer to import than all of the diagnosis: this way it is where a filter is asked for
import scipy

Array = np.ndarray
ORDER = 2
HIGHEST = 0.45
"""Cut-off frequency over the sample rate from which on nothing is filtered."""
FEWEST = 20
"""Rows that it takes at least to filter."""


def low_pass(x: Array, time: Array, cutoff: float) -> Array:
    """Rows x [T, ...] at times [T] (s) below a cut-off frequency (Hz), forwards and backwards; as they are where the
    frequency is infinite or above what the rows hold."""
    span = time[-1] - time[0]
    rate = (len(time) - 1) / span if span > 0 else 0.0
    if not np.isfinite(cutoff) or len(time) < FEWEST or cutoff > HIGHEST * rate:
        return x
    sos = _sections(cutoff / (0.5 * rate))
    # a stretch of a period mirrored at either end keeps the filter's transients outside
    pad = int(min(len(time) - 1, np.ceil(rate / cutoff)))
    return _evenly(
        x, time, lambda even: scipy.signal.sosfiltfilt(sos, even, axis=0, padtype="odd", padlen=pad)
    )


@lru_cache
def _sections(cutoff: float) -> Array:
    """A Butterworth filter by its cut-off frequency over half the sample rate."""
    return np.asarray(scipy.signal.butter(ORDER, cutoff, output="sos"))


def lagged(x: Array, time: Array, constant: float) -> Array:
    """Rows x [T, ...] at times [T] (s) behind a filter of first order with a time constant (s), at rest before the
    first."""
    if constant == 0.0 or len(time) < 2:
        return x
    h = (time[-1] - time[0]) / (len(time) - 1) / constant
    # exact where the signal is straight between rows
    decay = np.exp(-h)
    now = 1.0 - (1.0 - decay) / h
    b, a = [now, 1.0 - decay - now], [1.0, -decay]

    def behind(even: Array) -> Array:
        # what the filter holds where it had followed the first row for long
        start = (1.0 - now) * even[:1]
        return np.asarray(scipy.signal.lfilter(b, a, even, axis=0, zi=start)[0])

    return _evenly(x, time, behind)


def _evenly(x: Array, time: Array, filtered: Callable[[Array], Array]) -> Array:
    """What a filter makes of rows at even times, at the times of x."""
    even = np.linspace(time[0], time[-1], len(time))
    flat = x.reshape(len(x), -1)
    out = filtered(np.stack([np.interp(even, time, c) for c in flat.T], 1))
    return np.stack([np.interp(time, even, c) for c in out.T], 1).reshape(x.shape)
