"""One number measured on many robots: the shared value, how far robots differ, and which stand out.

The model is that of a random-effects meta-analysis, `y_i ~ N(mu, tau^2 + s_i^2)`: `y_i` is robot i's estimate, `s_i`
its standard error, `mu` the shared value, and `tau` the spread of the robots themselves.

Shapes: `K` robots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.optimize import brentq

Array = np.ndarray
LEVEL = 0.05
"""Chance that a robot of a fleet of equals is said to stand out."""
FEWEST = 4
"""Robots from which on one can stand out: three must be left to say what is usual."""
LARGEST_SHARE = 0.25
"""Of the robots, that can stand out: where more differ, that is the fleet's spread."""


@dataclass(frozen=True)
class Pooled:
    """What robots share.

    Attributes:
      value: mu.
      error: its standard error.
      spread: tau.
      spread_interval: of 95 %, from 0 on; None of one robot.
    """

    value: float
    error: float
    spread: float
    spread_interval: tuple[float, float] | None


def _scatter(y: Array, s: Array, square: float) -> tuple[float, float]:
    """The weighted mean and the weighted squared distances from it, at a given tau^2."""
    w = 1.0 / (s**2 + square)
    mean = float(np.sum(w * y) / np.sum(w))
    return mean, float(np.sum(w * (y - mean) ** 2))


def _square_at(y: Array, s: Array, level: float) -> float:
    """tau^2 at which the weighted squared distances come to `level`; 0 where they are less without any."""
    if _scatter(y, s, 0.0)[1] <= level:
        return 0.0
    top = float(np.sum((y - y.mean()) ** 2)) / level
    return float(brentq(lambda square: _scatter(y, s, square)[1] - level, 0.0, top, xtol=1e-12 * top))


def pool(y: Array, s: Array, interval: bool = True) -> Pooled:
    """Paule and Mandel's estimate of tau, the mean that goes with it, and tau's profile interval.

    Args:
      y, s: `[K]`, s positive.
      interval: without it `spread_interval` is None, and costs nothing.
    """
    freedom = len(y) - 1
    if freedom == 0:
        return Pooled(float(y[0]), float(s[0]), 0.0, None)
    square = _square_at(y, s, freedom)
    mean, _ = _scatter(y, s, square)
    ends = None
    if interval:
        low, high = (_square_at(y, s, float(stats.chi2.ppf(q, freedom))) ** 0.5 for q in (0.975, 0.025))
        ends = low, high
    return Pooled(mean, float(np.sum(1.0 / (s**2 + square))) ** -0.5, square**0.5, ends)


def standing_out(y: Array, s: Array, level: float = LEVEL) -> Array:
    """Which robots stand out, `[K]` of bools: Rosner's generalised test for several outliers, by deleted residuals.

    The robot farthest out is set against what all others share, then the next against those that are left, and so on;
    all up to the last one that is significant (Bonferroni over the robots) stand out. So one does not hide another.
    """
    out, taken, last = np.zeros(len(y), bool), [], 0
    rest = np.arange(len(y))
    for _ in range(int(LARGEST_SHARE * len(y)) if len(y) >= FEWEST else 0):
        pooled = pool(y[rest], s[rest], interval=False)
        far = int(np.argmax(np.abs(y[rest] - pooled.value) / np.hypot(s[rest], pooled.spread)))
        others = np.delete(rest, far)
        chance = 2 * stats.t.sf(
            abs(distance(y[rest[far]], s[rest[far]], y[others], s[others])), len(others) - 1
        )
        taken.append(rest[far])
        if chance < level / len(rest):
            last = len(taken)
        rest = others
    out[taken[:last]] = True
    return out


def distance(y: float, s: float, others_y: Array, others_s: Array) -> float:
    """How many standard deviations a robot's estimate is from what the others share."""
    pooled = pool(others_y, others_s, interval=False)
    return float((y - pooled.value) / np.sqrt(s**2 + pooled.spread**2 + pooled.error**2))


def shrunk(y: Array, s: Array, pooled: Pooled) -> Array:
    """Each robot's value given its own estimate and the fleet, `[K]`: nearer to mu the less its own recordings say."""
    own = pooled.spread**2 / (pooled.spread**2 + s**2)
    return pooled.value + own * (y - pooled.value)
