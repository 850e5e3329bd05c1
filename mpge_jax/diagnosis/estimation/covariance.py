"""What a fit knows of its parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mpge_jax.diagnosis.estimation.estimate import Fitted, prior_widths
from mpge_jax.diagnosis.estimation.parameter_steps import Problem

Array = np.ndarray


def finish(p: Problem) -> Fitted:
    """Information, and a covariance that is robust to misfit (clustered by window)."""
    if not p.params or not p.jacobian.size:
        return replace(p.fit, information=np.zeros((0, 0)), cov=np.zeros((0, 0)))
    j, r = p.jacobian, p.whitened
    weight = 1.0 / (1.0 + p.fit.x / 5.0)
    info = np.einsum("w,pwm,qwm->pq", weight, j, j, optimize=True)
    precision = info + np.diag(1.0 / prior_widths(p.params) ** 2)
    scale = 1.0 / np.sqrt(np.diag(precision))
    inverse = np.linalg.pinv(precision * scale[:, None] * scale[None, :], hermitian=True)
    inverse = inverse * scale[:, None] * scale[None, :]
    scores = np.einsum("w,pwm,wm->wp", weight, j, r, optimize=True)
    parts = np.einsum("w,pwm,qwm->wpq", weight, j, j, optimize=True)
    plain = inverse * max(1.0, float(np.mean(weight * p.fit.x) / np.mean(weight)))
    # the larger of the two, direction by direction on the diagonal
    left_out = jackknife(precision, parts, scores, scale)
    ratio = np.sqrt(np.maximum(left_out / np.maximum(np.diag(plain), 1e-300), 1.0))
    return replace(p.fit, information=info, cov=plain * ratio[:, None] * ratio[None, :])


def jackknife(precision: Array, parts: Array, scores: Array, scale: Array) -> Array:
    """Variances [p] by leaving out each window in turn: unlike the sandwich of the scores [W, p], they know that a
    window which decides much (information `parts` [W, p, p]) pulls the fit towards itself.

    Args:
        scale: [p] deviations that make `precision` [p, p] a matrix of ones on the diagonal.
    """
    n = max(len(scores), 1)
    values, vectors = np.linalg.eigh(precision * scale[:, None] * scale[None, :])
    root = scale[:, None] * vectors / np.sqrt(np.maximum(values, 1e-12))
    scores = scores - parts @ (root @ (root.T @ scores.sum(0)))
    kept, axes = np.linalg.eigh(np.eye(len(scale)) - root.T @ parts @ root)
    # where one window knows all but a thousandth, the others say no more than that
    steps = np.einsum("wpk,wp->wk", axes, scores @ root) / np.maximum(kept, 1e-3)
    moves = np.einsum("wpk,wk->wp", axes, steps) @ root.T
    return (moves**2).sum(0) * (n - 1) / n


def widened(cov: Array, error: Array) -> Array:
    """A covariance [p, p] whose deviations hold further errors [p] too, with its correlations."""
    deviation = np.sqrt(np.maximum(np.diag(cov), 0.0))
    widths = np.where(deviation > 0, np.hypot(deviation, error) / np.maximum(deviation, 1e-300), 1.0)
    return cov * widths[:, None] * widths[None, :]
