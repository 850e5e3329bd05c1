"""How finely motion and force are known: chosen on training recordings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.force_balance.balance import Balance
from mpge_jax.diagnosis.force_balance.bank import Bank
from mpge_jax.diagnosis.force_balance.low_pass import low_pass
from mpge_jax.diagnosis.force_balance.tracks import Resolution, tracks

Array = np.ndarray
SENSOR = (np.inf, 20.0, 10.0, 5.0, 3.0, 2.0, 1.5, 1.0)
MOTION = (np.inf, 10.0, 5.0, 2.0)
STILL = (0.0, 0.003, 0.01, 0.03)
"""What is tried: Hz, and shares of a joint's usual speed, from fine to coarse."""
FILTERED = 0.01
"""Share of a measured force (rms about its mean) that lies above twice the frequency of the filter that it came
through."""
BETTER = 0.02
"""By how much the logarithm of the error must fall for a coarser one."""
ROWS = 1500
"""Rows of the regressions by which they are judged."""


def choose(p: Prepared, terms: list[Term]) -> Resolution:
    """The resolution with which a plain regression of the forces predicts stretches best that it was not fitted to.

    All are judged by the same forces, those that were measured. A sensor's filter is supposed only where the forces
    hold nothing far above its frequency: else the smooth steps of a friction law would pass for a filter.

    Args:
        terms: of the plain regression.
    """

    def best(tried: Iterable[Resolution]) -> Resolution:
        chosen, least = Resolution(), np.inf
        for r in tried:
            rows = tracks(p, p.looked_at, ROWS, r)
            error = _error(Bank.of(Balance.of(p.ctx, rows, replace(r, motion=np.inf)), terms))
            if error < least - BETTER:
                chosen, least = r, error
        return chosen

    found = Resolution()
    tried: tuple[tuple[str, Iterable[Any]], ...] = (
        ("held", (False, True)),
        ("sensor", _possible(p)),
        ("motion", MOTION),
        ("still", STILL),
    )
    for name, values in tried:
        found = best(replace(found, **{name: x}) for x in values)
    return found


def _error(bank: Bank) -> float:
    """Mean logarithm of the actuators' rms errors, stretches predicted from the others."""
    n = bank.normal
    seen, rows = n.rows.sum(0) > 0, np.maximum(n.rows.sum(0), 1)
    size = np.maximum(n.square.sum(0) / rows, 1e-300)
    left = n.weighted(np.where(seen, 1.0 / size, 0.0)).predicted(range(len(n.prior)))
    return 0.5 * float(np.log(np.maximum(left / rows, 1e-12 * size)[seen]).mean())


def _possible(p: Prepared) -> list[float]:
    """Frequencies of filters through which the measured forces may have come."""
    forces = [(s.recording.known("force"), s.recording.time) for s in p.looked_at]
    whole = [f[np.isfinite(f).all(1)] for f, _ in forces]

    def above(cutoff: float) -> float:
        high, size = np.zeros(p.model.nu), np.zeros(p.model.nu)
        for force, (_, time) in zip(whole, forces, strict=True):
            if len(force) != len(time):
                return np.inf
            about = force - force.mean(0)
            high += ((about - low_pass(about, time, cutoff)) ** 2).sum(0)
            size += (about**2).sum(0)
        return float(np.sqrt(high / np.maximum(size, 1e-300))[p.measured].max())

    return [f for f in SENSOR if not np.isfinite(f) or above(2.0 * f) < FILTERED]
