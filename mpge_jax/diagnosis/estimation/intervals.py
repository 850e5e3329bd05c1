"""Parameters of a diagnosis as they are reported: values with 95 % intervals, and rivals that the data cannot part."""

from __future__ import annotations

from typing import Any

import numpy as np

from mpge_jax.diagnosis.effects.context import Context, default_places
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.covariance import WITHIN
from mpge_jax.diagnosis.estimation.estimate import Fitted

Array = np.ndarray


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
    """Reported parameters of one term with 95 % intervals: what follows from one fitted parameter lies between what the
    ends of its interval say, what follows from several is linear in them."""
    effect, place = term.effect, term.place
    part = f.hypothesis.slices(ctx)[f.hypothesis.terms.index(term)]
    theta, value = f.theta[part], effect.report(ctx, place, f.theta[part])
    cov = f.cov[part, part] if f.cov.size else np.zeros((theta.size, theta.size))
    deviation = np.sqrt(np.maximum(np.diag(cov), 0.0))
    params = effect.params(ctx, place)

    def told(i: int, x: float) -> dict[str, Array]:
        return effect.report(ctx, place, np.where(np.arange(theta.size) == i, x, theta))

    steps = 1e-4 * (np.abs(theta) + deviation) + 1e-12
    near = [told(i, theta[i] + h) for i, h in enumerate(steps)]
    reach = WITHIN * deviation
    ends = [
        [told(i, x) for x in np.clip([theta[i] - reach[i], theta[i] + reach[i]], p.low, p.high)]
        for i, p in enumerate(params)
    ]
    units, out = effect.units(ctx, place), {}
    for k, v in value.items():
        v = np.asarray(v, dtype=float)
        slopes = np.stack(
            [(np.asarray(x[k]) - v) / h for x, h in zip(near, steps, strict=True)] or [0.0 * v], -1
        )
        half = WITHIN * np.sqrt(np.maximum((slopes @ cov * slopes).sum(-1) if theta.size else 0.0 * v, 0.0))
        low, high = v - half, v + half
        by = np.flatnonzero(slopes.reshape(-1, slopes.shape[-1]).any(0))
        if by.size == 1 and v.ndim == 0:
            first, last = (float(np.asarray(x[k])) for x in ends[by[0]])
            low, high = min(first, last, float(v)), max(first, last, float(v))
        out[k] = {"value": plain(v), "low": plain(low), "high": plain(high), "unit": units.get(k, "1")}
    return out
