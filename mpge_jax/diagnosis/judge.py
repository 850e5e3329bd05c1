"""The judgement on a fit: what it does to held-out recordings, and whether what it leaves is more than noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mpge_jax.diagnosis.fitted import NOTHING, Fitted
from mpge_jax.diagnosis.hypothesis import Term
from mpge_jax.diagnosis.left import Remainder
from mpge_jax.diagnosis.prepare import Prepared
from mpge_jax.diagnosis.remainder import describe
from mpge_jax.diagnosis.select import Search
from mpge_jax.diagnosis.simulate import Run
from mpge_jax.diagnosis.verdict import LEFT, Errors, active_dofs, errors, excess_by_dof, noise_floor
from mpge_jax.diagnosis.whiten import (
    INTEGRATOR,
    LATE,
    NUISANCE,
    STEP,
    column_scale,
    numerics,
    whitener,
)
from mpge_jax.diagnosis.windows import Windows

Array = np.ndarray
TRAIN, HELD = 40, 60
"""Windows of the reported length on which errors are shown, at most."""
CLEAR = 2.0
"""How many times the noise the usual window's error must be for its share that is left to mean anything."""
SURE, MOST = 6.0, 3.0
"""Deviations from nothing at which differences of timing count as seen, and how many of those that whitening allows for
they may be."""
NUMERICS = {
    STEP: "the recordings move as with a finer timestep than the model's",
    LATE: "commands act at another moment within a timestep than the model has it",
    INTEGRATOR: "the recordings move as with another integrator than the model's",
}
"""What is said of `numerics` where they are seen; of Runge-Kutta the first is another integrator too."""


@dataclass(frozen=True)
class FitReport:
    """Open-loop errors on windows of the reported length, nominal and corrected model on the same windows.

    Attributes:
        floors: [W] rms error that the noise alone leaves in each window. floor: the same over all of them.
    """

    windows: Windows
    before: Errors
    after: Errors
    floors: Array
    floor: float

    def above(self, ratio: float) -> FitReport:
        """The same with `ratio` times the noise, which cannot be more than what is left."""
        return replace(self, floors=ratio * self.floors, floor=min(ratio * self.floor, self.after.rms))

    def left(self, rugged: bool) -> float:
        """Share of the error (rms beyond noise) that is left, between 0 and 1.

        Args:
            rugged: whether things strike each other. A few windows with impacts then hold all of the error and of the
                noise: what is left in the usual one counts too, where the noise does not hide what it missed.
        """
        share = _share(self.after.rms, self.before.rms, self.floor)
        if rugged and self.floors.size:
            after, before, floor = (
                float(np.median(x)) for x in (self.after.window, self.before.window, self.floors)
            )
            if before > CLEAR * floor:
                share = max(share, _share(after, before, floor))
        return min(share, 1.0)


def _share(after: float, before: float, floor: float) -> float:
    left, whole = (np.sqrt(max(x**2 - floor**2, 0.0)) for x in (after, before))
    return float(left / max(whole, 1e-12))


def fit_report(p: Prepared, f: Fitted, held: bool) -> FitReport:
    """Errors of the nominal model and of `f` on training or held-out recordings."""
    w = p.windows(held, p.config.report_s, HELD if held else TRAIN, seed=1)
    before = errors(p.sim, NOTHING, w)
    after = errors(p.sim, f, w) if f.hypothesis.terms else before
    scale = column_scale(p.noise, p.model)
    variance = noise_floor(p.sim, f, w, scale)
    return FitReport(w, before, after, np.sqrt(variance), float(np.sqrt(variance.mean())))


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


def what_is_left(p: Prepared, left: Remainder, held: FitReport, corrected: bool) -> dict[str, Any] | None:
    """The `unexplained` entry of a diagnosis, where what is left matters.

    Args:
        left: of the fit to the decision's windows. held: errors with the effects as reported. corrected: whether any
            effect was found.
    """
    beyond = held.left(p.sim.rugged(left.fit.hypothesis)) if corrected else 1.0
    if beyond < LEFT:
        p.warnings.append(
            f"a remainder of {100 * beyond:.1f} % of the error is more than noise (friction law, timestep or "
            "integrator differ in detail); it does not change what is named."
        )
        return None
    return describe(p, left, beyond**2)


def together(entries: list[dict[str, Any] | None]) -> dict[str, Any] | None:
    """One `unexplained` entry for several; its share is the first one's, of the motion if that is among them."""
    known = [e for e in entries if e is not None]
    if len(known) < 2:
        return known[0] if known else None
    return {
        "at": list(dict.fromkeys(at for e in known for at in e["at"])),
        "when": "; ".join(f"at the {' and '.join(e['at'])} {e['when']}" for e in known),
        "intervals": [i for e in known for i in e["intervals"]],
        "share": known[0]["share"],
        "of": known[0]["of"],
    }


def note_numerics(p: Prepared, f: Fitted, w: Windows) -> None:
    """Warn of an integrator, timestep or late commands behind the recordings that are not the model's, with the size of
    what they change: `numerics`, which searches see past."""
    nv = p.model.nv
    white = whitener(p.sim, f.hypothesis, f.theta, w, p.noise, temper=False)
    residual = p.sim.residuals([Run(f.hypothesis, f.theta)], w)[0]
    flat = white(residual)
    changes = numerics(p.sim, f.hypothesis, f.theta, w)
    weight = 1.0 / (1.0 + white.excess(flat) / 5.0)
    columns = np.stack([white(residual + change) - flat for change in changes.values()])
    gram = np.einsum("w,pwm,qwm->pq", weight, columns, columns, optimize=True)
    inverse = np.linalg.pinv(gram, hermitian=True)
    amount = -inverse @ np.einsum("w,pwm,wm->p", weight, columns, flat, optimize=True)
    left = flat + np.einsum("p,pwm->wm", amount, columns)
    scores = np.einsum("w,pwm,wm->wp", weight, columns, left, optimize=True)
    # misfit comes by the window
    variance = np.maximum(np.diag(inverse), np.diag(inverse @ scores.T @ scores @ inverse))
    seen = np.isfinite(residual[..., :nv])
    for k, (kind, change) in enumerate(changes.items()):
        moved = np.where(seen, amount[k] * np.nan_to_num(change[..., :nv]), 0.0)
        size = np.sqrt((moved**2).sum((0, 1)) / np.maximum(seen.sum((0, 1)), 1))
        matters = bool((size > column_scale(p.noise, p.model)[:nv])[seen.any((0, 1))].any())
        sure = amount[k] > SURE * np.sqrt(max(variance[k], 0.0)) and amount[k] < MOST * NUISANCE
        if sure and matters and kind in NUMERICS:
            what = NUMERICS[kind if INTEGRATOR in changes or kind == LATE else INTEGRATOR]
            p.warnings.append(
                f"{what}: {size.max():.1g} rad or m (rms, at the joint where it is most) over {w.times.max():.2g} s. "
                "This is taken into account and is not counted as missing physics."
            )


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
