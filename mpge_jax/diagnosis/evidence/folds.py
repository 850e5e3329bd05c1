"""Parts of recordings, each of which is predicted from the others."""

from __future__ import annotations

import numpy as np

Array = np.ndarray
FOLDS = 5
"""Parts, at most."""
RECORDINGS = 3
"""Recordings from which on parts are whole ones: what stretches of one recording have in common, others need not."""


def folds(recording: Array, start: Array) -> Array:
    """The part to which each block belongs [B]: whole recordings, or stretches of them where there are few.

    Args:
        recording: [B] number of each block's recording. start: [B] where it begins there.
    """
    number = np.unique(recording, return_inverse=True)[1]
    if number.max(initial=0) + 1 >= RECORDINGS:
        return number % FOLDS
    fold = np.empty(number.size, int)
    fold[np.lexsort((start, number))] = np.arange(number.size) * FOLDS // max(number.size, 1)
    return fold
