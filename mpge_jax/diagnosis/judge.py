"""The judgement on a fit: what it does to held-out recordings, and whether what it leaves is more than noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mpge_jax.diagnosis.calibrate import Floor
from mpge_jax.diagnosis.fit import NOTHING, Fitted
from mpge_jax.diagnosis.hypothesis import Term
from mpge_jax.diagnosis.prepare import Prepared
from mpge_jax.diagnosis.remainder import describe
from mpge_jax.diagnosis.select import Search
from mpge_jax.diagnosis.verdict import LEFT, Errors, active_dofs, errors, excess_by_dof, noise_floor
from mpge_jax.diagnosis.whiten import column_scale
from mpge_jax.diagnosis.windows import Windows

TRAIN, HELD = 40, 60
"""Windows of the reported length on which errors are shown, at most."""


@dataclass(frozen=True)
class FitReport:
    """Open-loop errors on windows of the reported length, nominal and corrected model on the same windows.

    Attributes:
        floor: rms error that the noise alone leaves.
    """

    windows: Windows
    before: Errors
    after: Errors
    floor: float

    def above(self, ratio: float) -> FitReport:
        """The same with `ratio` times the noise, which cannot be more than what is left."""
        return replace(self, floor=min(ratio * self.floor, self.after.rms))


def fit_report(p: Prepared, f: Fitted, held: bool) -> FitReport:
    """Errors of the nominal model and of `f` on training or held-out recordings."""
    w = p.windows(held, p.config.report_s, HELD if held else TRAIN, seed=1)
    before = errors(p.sim, NOTHING, w)
    after = errors(p.sim, f, w) if f.hypothesis.terms else before
    scale = column_scale(p.noise, p.model)
    return FitReport(w, before, after, float(np.sqrt(noise_floor(p.sim, f, w, scale).mean())))


def helps(held: FitReport) -> bool:
    """Whether held-out windows of the reported length are predicted better, in the mean or more often than not.

    The search judges in units of the noise, and mostly shorter windows: where the noise was underestimated, an effect
    may win there that helps nobody. Where there is no effect, nothing is asked.
    """
    before, after = held.before, held.after
    if before is after or not held.windows.count:
        return True
    oftener = (after.window < before.window).sum() > (after.window > before.window).sum()
    return bool(after.rms < before.rms or oftener)


def remains(s: Search, f: Fitted, noise: Floor) -> bool:
    """Whether `f` leaves more on the search's windows than the noise would."""
    best = s.score([f], s.whiten(f, temper=False))[0]
    losses = s.typical_losses(best)
    s.log.append(f"left: loss {losses.mean():.3f}, floor {noise.loss:.3f} +- {noise.error:.3f}")
    return noise.exceeded(losses) or noise.far(best.losses)


def what_is_left(
    p: Prepared, s: Search, decided: Fitted, held: FitReport, corrected: bool
) -> dict[str, Any] | None:
    """What the chosen effects leave that `remains`: the `unexplained` entry of a diagnosis.

    Args:
        decided: the fit to the decision's windows, on which the remainder is tested.
        held: errors with the effects as reported. corrected: whether any effect was found.
    """
    before, after = held.before.rms, held.after.rms
    beyond = np.sqrt(max(after**2 - held.floor**2, 0.0)) / max(
        np.sqrt(max(before**2 - held.floor**2, 0.0)), 1e-12
    )
    beyond = min(float(beyond), 1.0) if corrected else 1.0
    if beyond < LEFT:
        p.warnings.append(
            f"a remainder of {100 * beyond:.1f} % of the error is more than noise (friction law, timestep or "
            "integrator differ in detail); it does not change what is named."
        )
        return None
    whites = s.whiten(decided, temper=False)
    best = s.score([decided], whites)[0]
    ratio, _ = excess_by_dof(s.sim, decided, s.held, whites[1])
    return describe(p, s, best, ratio, beyond**2)


def error_drops(p: Prepared, f: Fitted, held: FitReport) -> dict[Term, float]:
    """Share of the held-out squared error that goes with each effect, the others kept."""
    out = {}
    parts = f.hypothesis.split(p.ctx, f.theta)
    for term in f.hypothesis.terms:
        h = f.hypothesis.without(term)
        without = errors(p.sim, replace(f, hypothesis=h, theta=h.gather(p.ctx, parts)), held.windows).rms
        out[term] = float(1.0 - held.after.rms**2 / max(without**2, 1e-30))
    return out


def locate(p: Prepared, s: Search) -> list[tuple[str, str, float]]:
    """Where the nominal model lacks force: (place, kind, ratio to what noise explains), largest first."""
    white = s.whiten_one(NOTHING, s.train, temper=False)
    ratio, _ = excess_by_dof(s.sim, NOTHING, s.train, white)
    out: dict[str, float] = {}
    for d in active_dofs(p.model) or range(p.model.nv):
        name = p.names.joint_of_dof(p.model, d)
        out[name] = max(out.get(name, 0.0), float(ratio[d]))
    return [(n, "joint", e) for n, e in sorted(out.items(), key=lambda x: -x[1])]
