"""A low-pass filter without phase, for rows at uneven times."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

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
    even = np.linspace(time[0], time[-1], len(time))
    sos = butter(ORDER, cutoff / (0.5 * rate), output="sos")
    flat = x.reshape(len(x), -1)
    evenly = np.stack([np.interp(even, time, c) for c in flat.T], 1)
    # a stretch of a period mirrored at either end keeps the filter's transients outside
    pad = int(min(len(time) - 1, np.ceil(rate / cutoff)))
    smooth = sosfiltfilt(sos, evenly, axis=0, padtype="odd", padlen=pad)
    return np.stack([np.interp(time, even, c) for c in smooth.T], 1).reshape(x.shape)
