"""How finely motion and force are known: chosen on training recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.force_balance.balance import Along, Balance
from mpge_jax.diagnosis.force_balance.bank import Bank
from mpge_jax.diagnosis.force_balance.low_pass import low_pass
from mpge_jax.diagnosis.force_balance.tracks import Resolution, tracks

Array = np.ndarray
SENSOR = (np.inf, 20.0, 10.0, 5.0, 3.0, 2.0, 1.5, 1.0)
LAG = (0.0, 0.002, 0.004, 0.007, 0.01, 0.015, 0.02, 0.03, 0.05)
MOTION = (np.inf, 10.0, 5.0, 2.0)
STILL = (0.0, 0.003, 0.01, 0.03)
"""What is tried: Hz, s, and shares of a joint's usual speed, from fine to coarse."""
FILTERED = 0.01
"""Share of a measured force (rms about its mean) that lies above twice the frequency of the filter that it came
through."""
ROUGHER = 1.05
"""Times as large (rms about its mean) as the measured force that one may have been before the filter that it came
through: a filter smooths, but takes little of what moves a machine."""
SUDDEN = ("sensor", "motion")
"""What smooths sudden forces: judged by all of them, turns and stops included, and the others where joints slide."""
BETTER = 0.02
"""By how much the logarithm of the error must fall for a coarser one."""
ROUNDS = 4
"""Most rounds in which one is chosen after the other, given all others, until none changes."""
ROWS = 1500
"""Rows of the regressions by which they are judged."""


def choose(
    p: Prepared, terms: list[Term], known: Mapping[Term, Array], along: dict[Resolution, Along] | None = None
) -> Resolution:
    """The resolution with which a plain regression of the forces predicts stretches best that it was not fitted to.

    All that is tried of one thing is judged by the same forces, as they were measured. A sensor's filter is supposed
    only where the forces hold nothing far above its frequency, and a lag only where the forces before it would be
    hardly larger: else the smooth steps of a friction law would pass for a filter. Over which speeds friction builds up
    is asked last, and of all forces.

    Args:
        terms: of the plain regression. known: parameters of what was found, near which that is told too. along: what
        was computed of motions that are known so finely (`motion_of`), by `ROWS` rows; it is added to.
    """
    others, along = [t for t in terms if t not in known], {} if along is None else along
    told: dict[tuple[Resolution, bool], float] = {}

    def error(r: Resolution, everywhere: bool) -> float:
        if (r, everywhere) not in told:
            rows = tracks(p, p.looked_at, ROWS, r)
            same = along.setdefault(motion_of(r), Along.nothing(len(rows)))
            b = Balance.of(p.ctx, rows, replace(r, motion=np.inf), same)
            judged = replace(b, telling=b.measured) if everywhere else b
            told[r, everywhere] = _error(Bank.of(judged, others, known.items()))
        return told[r, everywhere]

    def best(tried: Iterable[Resolution], everywhere: bool = False) -> Resolution:
        chosen, least = Resolution(), np.inf
        for r in tried:
            if (here := error(r, everywhere)) < least - BETTER:
                chosen, least = r, here
        return chosen

    tried: tuple[tuple[str, Iterable[Any]], ...] = (
        ("held", (False, True)),
        ("sensor", _filters(p)),
        ("motion", MOTION),
        ("lag", _lags(p)),
    )
    found = Resolution()
    for _ in range(ROUNDS):
        before = found
        for name, values in tried:
            found = best((replace(found, **{name: x}) for x in values), name in SUDDEN)
        if found == before:
            break
    return best((replace(found, still=x) for x in STILL), everywhere=True)


def motion_of(r: Resolution) -> Resolution:
    """What of it says how finely the motion is known."""
    return Resolution(motion=r.motion, still=r.still)


def _error(bank: Bank) -> float:
    """Mean logarithm of the actuators' rms errors, stretches predicted from the others."""
    n = bank.normal
    seen, rows = n.rows.sum(0) > 0, np.maximum(n.rows.sum(0), 1)
    size = np.maximum(n.square.sum(0) / rows, 1e-300)
    left = n.weighted(np.where(seen, 1.0 / size, 0.0)).predicted(range(len(n.prior)))
    return 0.5 * float(np.log(np.maximum(left / rows, 1e-12 * size)[seen]).mean())


def _filters(p: Prepared) -> list[float]:
    """Frequencies of filters without phase through which the measured forces may have come."""

    def above(cutoff: float) -> float:
        return _most(p, lambda force, time: force - low_pass(force, time, cutoff))

    return [f for f in SENSOR if not np.isfinite(f) or above(2.0 * f) < FILTERED]


def _lags(p: Prepared) -> list[float]:
    """Time constants of filters of first order through which the measured forces may have come."""

    def unfiltered(lag: float) -> float:
        return _most(p, lambda force, time: force + lag * np.gradient(force, time, axis=0))

    return [lag for lag in LAG if lag == 0.0 or unfiltered(lag) < ROUGHER]


def _most(p: Prepared, of: Callable[[Array, Array], Array]) -> float:
    """Rms of something of the measured forces about their means, over that of these forces: the most of all actuators;
    infinite where forces have holes.

    Args:
        of: forces [T, nu] about their means, and times [T], to [T, nu].
    """
    made, size = np.zeros(p.model.nu), np.zeros(p.model.nu)
    for s in p.looked_at:
        force, time = s.recording.known("force"), s.recording.time
        if not np.isfinite(force[:, p.measured]).all():
            return np.inf
        about = np.nan_to_num(force - force.mean(0))
        made += (of(about, time) ** 2).sum(0)
        size += (about**2).sum(0)
    return float(np.sqrt(made / np.maximum(size, 1e-300))[p.measured].max())
