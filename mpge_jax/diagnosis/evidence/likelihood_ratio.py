"""How far gains of windows speak for one of two hypotheses."""

from __future__ import annotations

import numpy as np

from mpge_jax.diagnosis.recordings.noise_level import MAD
from mpge_jax.diagnosis.thresholds import CLEARLY, ORDINARY, OUTLYING, SURE

Array = np.ndarray


def log_ratio(gain: Array) -> float:
    """Logarithm of the likelihood ratio that paired gains of windows [W], or of joints in windows [W, joints], speak
    of; negative where they are losses.

    Gains are differences of minus twice a logarithm of a likelihood, in which a window, or one of its joints, counts as
    one observation. It holds more than one, nobody knows how many, but scatter tells (`by_scatter`). What comes to less
    than `SURE` if it is one (half the sum) is too little to tell from what fits and numerics leave, however regular it
    is.
    """
    windows = gain if gain.ndim == 1 else gain.sum(1)
    least = 0.5 * float(windows.sum())
    return least if abs(least) < SURE else by_scatter(windows)


def beyond_doubt(ratio: float, among: int = 1, effects: int = 1) -> bool:
    """Whether the logarithm of a likelihood ratio says that one hypothesis is the better one, where it adds so many
    `effects`, each the best of so many candidates."""
    return ratio > SURE + effects * np.log(max(among, 1))


def by_scatter(gain: Array) -> float:
    """The same by how paired gains [W] scatter alone, in whatever unit they are.

    The log likelihood ratio of two hypotheses, of which one is true, has twice its mean as its variance. So it is twice
    the square of the deviations by which the mean of independent windows exceeds zero; where few windows decide, it is
    little.
    """
    sign = float(np.sign(gain.sum()))
    return sign * 2.0 * min(deviations(sign * gain), 1e6) ** 2


def odds(ratio: float) -> str:
    """The logarithm of a likelihood ratio in words: 'odds of 20 to 1'."""
    if ratio > np.log(1e6):
        return "odds of more than a million to 1"
    return f"odds of {np.exp(ratio):,.0f} to 1"


def stand_out(losses: Array) -> Array:
    """Which windows [W] stand out from others that show nothing but noise; none where those show more, or so much less
    that the noise is overestimated. Only for losses in units of the noise (of a whitener that is not tempered)."""
    middle = float(np.median(losses))
    scatter = MAD * float(np.median(np.abs(losses - middle)))
    if not 0.5 <= middle <= ORDINARY:
        return np.zeros(losses.shape, bool)
    return losses > middle + max(OUTLYING * scatter, CLEARLY)


def deviations(gain: Array) -> float:
    """By how many standard deviations paired gains [W] exceed zero: by their mean, or by their ranks (Wilcoxon's
    signed-rank test), which a few windows that something else spoils do not blur."""
    ranks = np.sign(gain) * _ranks(np.abs(gain))
    by_rank = float(ranks.sum() / max(np.sqrt((ranks**2).sum()), 1e-300))
    return max(float(gain.mean()) / max(standard_error(gain), 1e-300), by_rank)


def _ranks(x: Array) -> Array:
    """Ranks [W] from 1 on; equal values share the mean of theirs."""
    _, which, count = np.unique(x, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - 0.5 * (count - 1))[which]


def standard_error(difference: Array) -> float:
    n = difference.size
    return float(difference.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")
