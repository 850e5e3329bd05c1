"""Parameters of a diagnosis as they are reported: values with 95 % intervals, and rivals that the data cannot part."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.context import Context, default_places
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.covariance import WITHIN
from mpge_jax.diagnosis.estimation.estimate import Fitted


def number(x: float) -> float | None:
    """A float for JSON (no NaN, no infinity), at a sensible length."""
    return float(f"{float(x):.6g}") if np.isfinite(x) else None


def plain(value: Any) -> Any:
    value = np.asarray(value, dtype=float)
    return number(value) if value.ndim == 0 else [number(v) for v in value]


def inertia_factors(ctx: Context, f: Fitted) -> list[dict[str, Any]] | None:
    """By how much every given mass and inertia is off, if a fit corrects them: factors with intervals, by body."""
    given = next((t for t in f.hypothesis.terms if not t.effect.named), None)
    if given is None:
        return None
    factors = parameters(ctx, f, given)
    return [
        {"at": body.name}
        | {what: {k: x[k][i] for k in ("value", "low", "high")} for what, x in factors.items()}
        for i, body in enumerate(default_places(ctx, "body"))
    ]


def parameters(ctx: Context, f: Fitted, term: Term) -> dict[str, Any]:
    """Reported parameters of one term with 95 % intervals."""
    effect, place = term.effect, term.place
    part = f.hypothesis.slices(ctx)[f.hypothesis.terms.index(term)]
    theta = f.theta[part]
    value = effect.report(ctx, place, theta)
    spread = {k: np.zeros_like(np.asarray(v, dtype=float)) for k, v in value.items()}
    if f.cov.size and theta.size:
        deviation = np.sqrt(np.maximum(np.diag(f.cov[part, part]), 0.0))
        for i in range(theta.size):
            h = 1e-4 * (abs(theta[i]) + deviation[i]) + 1e-12
            moved = theta.copy()
            moved[i] += h
            for j in range(theta.size):
                other = theta.copy()
                hj = 1e-4 * (abs(theta[j]) + deviation[j]) + 1e-12
                other[j] += hj
                ci = f.cov[part, part][i, j]
                a, b = effect.report(ctx, place, moved), effect.report(ctx, place, other)
                for k in value:
                    gi = (np.asarray(a[k]) - np.asarray(value[k])) / h
                    gj = (np.asarray(b[k]) - np.asarray(value[k])) / hj
                    spread[k] = spread[k] + gi * gj * ci
    units = effect.units(ctx, place)
    # of what is reported as it is fitted, not of what is told in its place
    fitted = zip(effect.params(ctx, place), theta, strict=True)
    limits = {p.name: (p.low, p.high) for p, x in fitted if np.array_equal(value.get(p.name, np.nan), x)}
    out = {}
    for k, v in value.items():
        half = WITHIN * np.sqrt(np.maximum(spread[k], 0.0))
        out[k] = {
            "value": plain(v),
            "low": plain(np.maximum(np.asarray(v) - half, limits.get(k, (-np.inf, np.inf))[0])),
            "high": plain(np.minimum(np.asarray(v) + half, limits.get(k, (-np.inf, np.inf))[1])),
            "unit": units.get(k, "1"),
        }
    return out
