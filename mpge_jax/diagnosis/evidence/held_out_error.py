"""Errors of a fit on training and held-out recordings, beside the noise."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.effects.hypothesis import Term
from mpge_jax.diagnosis.estimation.estimate import NOTHING, Fitted
from mpge_jax.diagnosis.estimation.prediction_error import (
    NO_AMOUNTS,
    Errors,
    MeanSquare,
    errors,
    noise_floor,
    rms_by_joint,
)
from mpge_jax.diagnosis.evidence.null_distribution import force_noise
from mpge_jax.diagnosis.machine.joint_space import difference
from mpge_jax.diagnosis.recordings.three_parts import Part
from mpge_jax.diagnosis.simulation.windows import Windows
from mpge_jax.diagnosis.thresholds import MEANS_SOMETHING

Array = np.ndarray


WINDOWS: dict[Part, int] = {"train": 40, "choice": 60, "test": 60}
"""Windows of the reported length on which errors are shown, at most."""


@dataclass(frozen=True)
class FitReport:
    """Open-loop errors on windows of the reported length, nominal and corrected model on the same windows.

    Attributes:
        floors: [W] rms error that noise alone leaves in each window, and what is no missing physics either
            (`beside`). floor: the same over all of them. joint_floors: [nv] of each degree of freedom.
        moved: [nv] rms by which the machine moves from where a window starts: the error of who predicts no motion.
        amounts: of `numerics` that predictions have here.
    """

    windows: Windows
    before: Errors
    after: Errors
    floors: Array
    floor: float
    joint_floors: Array
    moved: Array
    amounts: Mapping[str, float] = field(default_factory=dict)

    def above(self, ratio: float) -> FitReport:
        """The same with `ratio` times the noise."""
        return replace(
            self,
            floors=ratio * self.floors,
            floor=ratio * self.floor,
            joint_floors=ratio * self.joint_floors,
        )

    def beside(self, *more: MeanSquare) -> FitReport:
        """The same where things that are no missing physics leave errors too."""
        square = sum(more, MeanSquare(self.floors**2, self.joint_floors**2))
        whole = np.sqrt(self.floor**2 + (square.window - self.floors**2).mean())
        return replace(
            self, floors=np.sqrt(square.window), floor=float(whole), joint_floors=np.sqrt(square.joint)
        )

    def left(self, rugged: bool) -> float:
        """Share of the error (rms beyond noise) that is left, between 0 and 1: of that of the model as given, or of who
        predicts no motion at joints where that is less. What flies away without an effect makes any rest seem slight.

        Args:
            rugged: whether things strike each other. A few windows with impacts then hold all of the error and of the
                noise: what is left in the usual one counts too, where the noise does not hide what it missed.
        """
        share = _share(self.after.rms, min(self.before.rms, self._least), self.floor)
        if rugged and self.floors.size:
            after, before, floor = (
                float(np.median(x)) for x in (self.after.window, self.before.window, self.floors)
            )
            if before > MEANS_SOMETHING * floor:
                share = max(share, _share(after, before, floor))
        return min(share, 1.0)

    def left_at(self, dofs: Array) -> float:
        """Share that is left, at some degrees of freedom, of the squared error of the model as given (of who predicts
        no motion, where that is less), beyond noise; 0 where none exceeds `MEANS_SOMETHING` times its noise.

        Args:
            dofs: [nv] which ones.
        """
        after, before = self.after.joint[dofs], self.no_more_than_moved(self.before.joint)[dofs]
        floor = self.joint_floors[dofs]
        if not (after > MEANS_SOMETHING * floor).any():
            return 0.0
        left, whole = (float(np.nansum(np.maximum(x**2 - floor**2, 0.0))) for x in (after, before))
        return min(left / max(whole, 1e-300), 1.0)

    @property
    def flies_away(self) -> bool:
        """Whether predicting no motion at some joints is better than the model as given by far."""
        return bool(self._least < 0.5 * self.before.rms)

    @property
    def _least(self) -> float:
        each = self.no_more_than_moved(self.before.joint)
        return float(np.sqrt(np.mean(each[np.isfinite(each)] ** 2))) if np.isfinite(each).any() else np.inf

    def no_more_than_moved(self, joint: Array) -> Array:
        """Errors [nv], or those of who predicts no motion where these are less."""
        return np.minimum(joint, self.moved)


def _share(after: float, before: float, floor: float) -> float:
    left, whole = (np.sqrt(max(x**2 - floor**2, 0.0)) for x in (after, before))
    return float(left / max(whole, 1e-12))


def judged(p: Prepared, part: Part) -> Windows:
    """The windows on which errors of the recordings of one part are told."""
    return p.windows(part, p.config.report_s, WINDOWS[part], seed=1, judged=True)


def fit_report(p: Prepared, f: Fitted, part: Part, amounts: Mapping[str, float] = NO_AMOUNTS) -> FitReport:
    """Errors of the nominal model and of `f` on the recordings of one part, with some amounts of `numerics`."""
    w = judged(p, part)
    before = errors(p.sim, NOTHING, w, p.noise, amounts)
    after = errors(p.sim, f, w, p.noise, amounts) if f.hypothesis.terms else before
    variance = noise_floor(p.sim, f, w, p.noise, force_noise(p))
    each, joint = np.sqrt(variance.window), np.sqrt(variance.joint)
    whole = float(np.sqrt(variance.window.mean()))
    return FitReport(w, before, after, each, whole, joint, _moved(p, w), amounts)


def left_at_joints(p: Prepared, report: FitReport, joints: Iterable[int]) -> float:
    """The most that is `left_at` one of some joints, 0 where there are none."""
    return max((report.left_at(p.model.dof_jntid == j) for j in joints), default=0.0)


def _moved(p: Prepared, w: Windows) -> Array:
    """Rms [nv] by which positions differ from those at the start of their window (NaN where unmeasured)."""
    away = np.where(w.seen[..., None], difference(p.model, w.q0[:, None], w.qpos), np.nan)
    return rms_by_joint(away)


def error_drops(p: Prepared, f: Fitted, w: Windows, terms: Sequence[Term]) -> dict[Term, float]:
    """Share of the squared error in windows that goes with each of some terms of `f`, the others kept."""
    after = errors(p.sim, f, w, p.noise).rms
    return {t: float(1.0 - after**2 / max(e.rms**2, 1e-30)) for t, e in _without(p, f, w, terms).items()}


def errors_without(p: Prepared, f: Fitted, report: FitReport) -> dict[Term, Errors]:
    """Errors on a report's windows without each effect, the others kept."""
    return _without(p, f, report.windows, f.hypothesis.terms, report.amounts)


def _without(
    p: Prepared, f: Fitted, w: Windows, terms: Sequence[Term], amounts: Mapping[str, float] = NO_AMOUNTS
) -> dict[Term, Errors]:
    h = f.hypothesis
    return {t: errors(p.sim, f.of_terms(p.ctx, h.without(t)), w, p.noise, amounts, near=f) for t in terms}


BY_CHANCE = "some recordings speak for it, but others are not predicted better with it by more than chance"
MAY_BE_NONE = "its 95 % interval, with what recordings and masses leave open, holds that there is none"


def left_out(gone: list[Term], why: str) -> list[str]:
    """What is said of effects that were found and are not reported; nothing where there are none."""
    gone = [t for t in gone if t.effect.named]
    if not gone:
        return []
    listed = ", ".join(f"{t.name.replace('_', ' ')} at {t.place.name}" for t in gone)
    return [f"{listed}: {why}; it is left out."]
