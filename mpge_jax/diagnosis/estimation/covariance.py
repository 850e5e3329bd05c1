"""What a fit knows of its parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtri, stdtrit

from mpge_jax.diagnosis.estimation.estimate import Fitted, prior_widths
from mpge_jax.diagnosis.estimation.parameter_steps import Problem

Array = np.ndarray
WITHIN = float(ndtri(0.975))
"""Deviations on either side that a 95 % interval holds."""


def finish(p: Problem) -> Fitted:
    """Information, and a covariance that is robust to misfit (clustered by window)."""
    if not p.params or not p.jacobian.size:
        return replace(p.fit, information=np.zeros((0, 0)), cov=np.zeros((0, 0)))
    parts, scores, precision, scale = _by_window(p)
    inverse = np.linalg.pinv(precision * scale[:, None] * scale[None, :], hermitian=True)
    plain = inverse * scale[:, None] * scale[None, :] * _misfit(p)
    # the larger of the two, direction by direction on the diagonal
    left_out, _ = jackknife(precision, parts, scores, scale)
    ratio = np.sqrt(np.maximum(left_out / np.maximum(np.diag(plain), 1e-300), 1.0))
    return replace(p.fit, information=parts.sum(0), cov=plain * ratio[:, None] * ratio[None, :])


def recordings_differ(p: Problem, source: Array) -> Array:
    """Variances [p] that parameters have because recordings contradict each other: by how much more it moves them to
    leave out each recording in turn than noise would.

    What a law misses that is not quite the machine's is alike in the windows of one recording, so that windows do not
    tell it. Few recordings tell it badly, as Student's t has it.

    Args:
        source: [W] the recording of each window.
    """
    each = np.unique(source)
    if each.size < 2 or not p.params or not p.jacobian.size:
        return np.zeros(len(p.params))
    parts, scores, precision, scale = _by_window(p)
    of = (source[None, :] == each[:, None]).astype(float)
    left_out, by_noise = jackknife(
        precision, np.einsum("gw,wpq->gpq", of, parts, optimize=True), of @ scores, scale
    )
    few = stdtrit(each.size - 1, 0.975) / WITHIN
    return few**2 * np.maximum(left_out - _misfit(p) * by_noise, 0.0)


def _by_window(p: Problem) -> tuple[Array, Array, Array, Array]:
    """Information [W, p, p] and scores [W, p] of the windows, the precision [p, p] of all with the prior, and the
    deviations [p] that make it a matrix of ones on the diagonal."""
    j, weight = p.jacobian, p.weight
    parts = np.einsum("w,pwm,qwm->wpq", weight, j, j, optimize=True)
    scores = np.einsum("w,pwm,wm->wp", weight, j, p.whitened, optimize=True)
    precision = parts.sum(0) + np.diag(1.0 / prior_widths(p.params) ** 2)
    return parts, scores, precision, 1.0 / np.sqrt(np.diag(precision))


def _misfit(p: Problem) -> float:
    """Squared error of a window over that of noise, 1 at least."""
    return max(1.0, float(np.average(p.fit.x, weights=p.weight)))


def jackknife(precision: Array, parts: Array, scores: Array, scale: Array) -> tuple[Array, Array]:
    """Variances [p] by leaving out each window in turn, and what they would be by noise alone: unlike the sandwich of
    the scores [W, p], they know that a window which decides much (information `parts` [W, p, p]) pulls the fit towards
    itself.

    Args:
        scale: [p] deviations that make `precision` [p, p] a matrix of ones on the diagonal.
    """
    n = max(len(scores), 1)
    values, vectors = np.linalg.eigh(precision * scale[:, None] * scale[None, :])
    root = scale[:, None] * vectors / np.sqrt(np.maximum(values, 1e-12))
    scores = scores - parts @ (root @ (root.T @ scores.sum(0)))
    kept, axes = np.linalg.eigh(np.eye(len(scale)) - root.T @ parts @ root)
    # where one window knows all but a thousandth, the others say no more than that
    kept = np.clip(kept, 1e-3, 1.0)
    towards = root @ axes
    moves = np.einsum("wpk,wk->wp", towards, np.einsum("wpk,wp->wk", axes, scores @ root) / kept)
    by_noise = np.einsum("wpk,wk->p", towards**2, (1.0 - kept) / kept)
    return (moves**2).sum(0) * (n - 1) / n, by_noise * (n - 1) / n


def widened(cov: Array, error: Array) -> Array:
    """A covariance [p, p] whose deviations hold further errors [p] too, with its correlations."""
    deviation = np.sqrt(np.maximum(np.diag(cov), 0.0))
    widths = np.where(deviation > 0, np.hypot(deviation, error) / np.maximum(deviation, 1e-300), 1.0)
    return cov * widths[:, None] * widths[None, :]
