"""Whether a number differs from recording to recording, or only from part to part of each: a model of random effects.

A part k of recording r tells z_rk = c + own_r + e_rk, with e_rk ~ N(0, d_rk^2 + part^2) and own_r ~ N(0, between^2): d
is what its windows leave open, `part` what the model misses otherwise in one part than in the next. What belongs to a
recording is the same in all of its parts; what does not is misfit that a number took up (Searle, Casella and McCulloch,
Variance Components, 1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mpge_jax.diagnosis.evidence.likelihood_ratio import beyond_doubt

Array = np.ndarray
GRID, RANGE = 41, (0.02, 3.0)
"""Values of either deviation that are tried, and between which multiples of the largest distance from the median."""


@dataclass(frozen=True)
class Between:
    """How R recordings differ in one number.

    Attributes:
        common: c. own: [R] by how much each differs from it, drawn towards nothing by as much as its parts leave open.
        ratio: logarithm of the likelihood ratio of recordings that differ over recordings that do not.
    """

    common: float
    own: Array
    ratio: float


def between_recordings(values: Array, deviations: Array, of: Array, looked: Array) -> Between:
    """How recordings differ, by maximum likelihood.

    Args:
        values, deviations: [P] of the parts. of: [P] to which of the R recordings each belongs. looked: [R] which of
            them tell how far recordings and parts differ; of the others their own is told.
    """
    told = looked[of]
    z, d, rows = values[told], deviations[told], of[told]
    size = max(float(np.abs(z - np.median(z)).max(initial=0.0)), 1e-12)
    tried = np.concatenate([[0.0], size * np.geomspace(*RANGE, GRID)])
    each = np.stack([_likelihood(z, d, rows, looked.size, tried, x) for x in tried], 1)
    between, part = (tried[k] for k in np.unravel_index(int(each.argmax()), each.shape))
    ratio = float(each.max() - each[0].max())
    mean, variance = _by_recording(values, np.hypot(deviations, part), of, looked.size)
    weight = np.where(looked, 1.0 / (between**2 + variance), 0.0)
    common = float((weight * mean).sum() / weight.sum())
    if not beyond_doubt(0.5 * common**2 * float(weight.sum())):
        common = 0.0
    own = between**2 / (between**2 + variance) * (mean - common)
    return Between(common, own, ratio)


def _by_recording(values: Array, deviations: Array, of: Array, count: int) -> tuple[Array, Array]:
    """Mean [R] of the parts of each recording, weighted by what they leave open, and its variance [R]."""
    weight = 1.0 / np.maximum(deviations, 1e-12) ** 2
    total = np.bincount(of, weight, count)
    variance = 1.0 / np.maximum(total, 1e-12)
    return np.bincount(of, weight * values, count) * variance, variance


def _likelihood(z: Array, d: Array, of: Array, count: int, between: float | Array, part: float) -> Array:
    """Logarithm of the likelihood [...] of deviations `between` [...] and `part`, c at its best, up to a constant."""
    own = np.hypot(d, part)
    mean, variance = _by_recording(z, own, of, count)
    inside = ((z - mean[of]) / own) ** 2
    some = np.bincount(of, minlength=count) > 0
    mean, variance = mean[some], variance[some]
    total = variance + np.square(between)[..., None]
    common = (mean / total).sum(-1, keepdims=True) / (1.0 / total).sum(-1, keepdims=True)
    # of the parts around their recording's mean, and of the means around the common one
    logs = np.log(own**2).sum() - np.log(variance).sum() + np.log(total).sum(-1)
    return -0.5 * (inside.sum() + ((mean - common) ** 2 / total).sum(-1) + logs)
