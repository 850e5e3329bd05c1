"""How far paired gains of windows speak for an effect."""

from __future__ import annotations

import numpy as np
from scipy.stats import rankdata

Array = np.ndarray
EVIDENCE, STRONG = 6.0, 15.0
"""Twice the log-likelihood ratio of held-out windows that an effect needs, and that it needs where it acts too rarely
for its mean gain to stand out (see `strong`)."""
BALANCE = 4.0
"""How many times the gains must outweigh the losses then."""


def strong(gain: Array, total: Array) -> bool:
    """Whether gains of held-out windows, and of all windows, speak for an effect that acts in few of them.

    The loss 5 log(1 + x / 5) is minus twice the log-likelihood of Student's t with heavy tails, each window counted
    as one observation, so the gains add up to twice a log-likelihood ratio. A mean over standard error does not see
    an effect that acts in five windows of forty, however large it is there. No single window decides, and what
    another model makes worse as often as better (chaotic contacts) does not count.
    """
    up, down = (np.maximum(s * gain, 0.0).sum() for s in (1.0, -1.0))
    spread = total.sum() - total.max(initial=0.0)
    return bool(gain.sum() > STRONG and spread > STRONG and up > BALANCE * down)


def deviations(gain: Array) -> float:
    """By how many standard deviations paired gains [W] exceed zero: by their mean, or by their ranks (Wilcoxon's
    signed-rank test), which a few windows that something else spoils do not blur."""
    ranks = np.sign(gain) * rankdata(np.abs(gain))
    by_rank = float(ranks.sum() / max(np.sqrt((ranks**2).sum()), 1e-300))
    return max(float(gain.mean()) / max(standard_error(gain), 1e-300), by_rank)


def standard_error(difference: Array) -> float:
    n = difference.size
    return float(difference.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")
