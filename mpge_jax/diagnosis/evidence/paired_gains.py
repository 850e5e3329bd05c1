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
ORDINARY, OUTLYING, CLEARLY, SEVERAL = 1.15, 8.0, 0.5, 3
"""Median loss where all but a few windows show noise alone; deviations from it, and relative chi^2, by which a window
stands out at least; and how many such windows are no accident."""


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


def stand_out(losses: Array) -> Array:
    """Which windows [W] stand out from others that show nothing but noise; none where those show more, or so much less
    that the noise is overestimated. Only for losses in units of the noise (of a whitener that is not tempered)."""
    middle = float(np.median(losses))
    scatter = 1.4826 * float(np.median(np.abs(losses - middle)))
    if not 0.5 <= middle <= ORDINARY:
        return np.zeros(losses.shape, bool)
    return losses > middle + max(OUTLYING * scatter, CLEARLY)


def rare(worse: Array, better: Array, fitted: int) -> bool:
    """Whether `better` explains most of what stands out under `worse`, in several windows, and spoils no others.

    Args:
        worse, better: losses [W]. fitted: how many of the windows, the first ones, `better` was fitted to; it must
            explain at least one of the others.

    An effect that acts in one window of forty (a motor that seldom saturates) hardly moves a mean, but where all
    else is at the noise, the windows in which it acts are many deviations away from it.
    """
    out = stand_out(worse)
    if out.sum() < SEVERAL:
        return False
    gain, middle = worse - better, float(np.median(worse))
    explained = out & (gain > 0.5 * (worse - middle))
    return bool(
        explained.sum() >= max(SEVERAL, 0.75 * out.sum())
        and explained[fitted:].any()
        and gain[out].sum() > BALANCE * np.maximum(-gain, 0.0).sum()
    )


def deviations(gain: Array) -> float:
    """By how many standard deviations paired gains [W] exceed zero: by their mean, or by their ranks (Wilcoxon's
    signed-rank test), which a few windows that something else spoils do not blur."""
    ranks = np.sign(gain) * rankdata(np.abs(gain))
    by_rank = float(ranks.sum() / max(np.sqrt((ranks**2).sum()), 1e-300))
    return max(float(gain.mean()) / max(standard_error(gain), 1e-300), by_rank)


def standard_error(difference: Array) -> float:
    n = difference.size
    return float(difference.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")
