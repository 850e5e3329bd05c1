"""Which windows are looked at: some at random, and those where the model misses most."""

from __future__ import annotations

import numpy as np

Array = np.ndarray
SCREEN_WINDOWS = 14


def telling_windows(x: Array, limit: int, rng: np.random.Generator) -> tuple[Array, int]:
    """(indices of at most `limit` windows, how many of them are random): two thirds at random, which come first,
    then those where the nominal model misses most, as an effect that acts now and then shows there alone. x: [W]."""
    if x.size <= limit:
        return np.arange(x.size), x.size
    worst = np.argsort(-x)[: limit // 3]
    others = rng.permutation(np.setdiff1d(np.arange(x.size), worst))[: limit - worst.size]
    return np.concatenate([np.sort(others), np.sort(worst)]), others.size


def screen_windows(x: Array, rng: np.random.Generator) -> Array:
    """Windows for screening: a third of them where the base misses most (what acts now and then must be among
    them), the others at random. x: [W] misfit of the base."""
    return np.sort(telling_windows(x, SCREEN_WINDOWS, rng)[0])
