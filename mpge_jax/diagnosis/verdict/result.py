"""What a diagnosis found: plain data, for whatever writes, draws or rebuilds it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mpge_jax.diagnosis.config import Config
from mpge_jax.diagnosis.dataset.prepared import Prepared
from mpge_jax.diagnosis.drives.command_to_force import ActuatorSide
from mpge_jax.diagnosis.effects.context import Context
from mpge_jax.diagnosis.effects.hypothesis import Hypothesis, Term
from mpge_jax.diagnosis.estimation.estimate import Fitted
from mpge_jax.diagnosis.estimation.intervals import inertia_factors
from mpge_jax.diagnosis.evidence.held_out_error import FitReport
from mpge_jax.diagnosis.evidence.scored import Rival
from mpge_jax.diagnosis.force_balance.force_errors import ForceErrors
from mpge_jax.diagnosis.residual.model import ResidualModel

CANDIDATES = 4
"""Fits, at most, that are listed where the data cannot tell which."""


@dataclass(frozen=True)
class Result:
    """What is missing in a model, with everything that supports it; in SI units, angles in radians.

    Attributes:
        verdict: "effects", "ambiguous", "unexplained" or "none".
        fit: the chosen effects with parameters and covariances. rivals: alternatives by term.
        error_drop: share of the held-out squared error that goes with each term, the others kept, those functions of
        motion too that are the residual.
        train, held: errors before and after on training and on test recordings; of forces where the motion is given
        and they are predicted, else of motion. location: (place, kind, excess), largest first.
        unexplained: what is left, or None. actuators: what was found between command and measured force.
        log: what was tried, line by line. seconds: how long it took. model: file of the nominal model, if it had one.
        remainder: share of the held-out squared error that is more than noise, and too slight to change the verdict.
        residual: what is left as functions, where these make test recordings better predicted.
        doubtful: effects, of drives too, that may be a part of what is left.
    """

    verdict: str
    prepared: Prepared
    fit: Fitted
    rivals: dict[Term, list[Rival]]
    error_drop: dict[Term, float]
    train: FitReport | ForceErrors
    held: FitReport | ForceErrors
    location: list[tuple[str, str, float]]
    unexplained: dict[str, Any] | None
    warnings: list[str]
    config: Config
    log: list[str] = field(default_factory=list)
    actuators: ActuatorSide | None = None
    seconds: float = 0.0
    remainder: float = 0.0
    residual: ResidualModel | None = None
    doubtful: tuple[Term, ...] = ()
    model: Path | None = None

    @property
    def ctx(self) -> Context:
        return self.prepared.ctx

    @property
    def terms(self) -> tuple[Term, ...]:
        """The effects that are named of the machine itself, all that there are where no command was recorded beside a
        measured force."""
        return self.fit.hypothesis.named

    @property
    def named(self) -> tuple[Term, ...]:
        """All effects that are named, those between commands and measured forces too."""
        drives = [] if self.actuators is None else self.actuators.fits
        return (*self.terms, *(t for f in drives for t in f.hypothesis.named))

    @property
    def given_inertias(self) -> list[dict[str, Any]] | None:
        """By how much every given mass and inertia is off, body by body, where that was found."""
        return inertia_factors(self.ctx, self.fit)


def candidates_of(d: Result) -> dict[Term, list[Fitted]]:
    """For every ambiguous term: the chosen fit and those that the data cannot tell from it (`CANDIDATES` at most), one
    of each effect before others of the same, of which the chosen one is one."""
    out = {}
    for term, rivals in d.rivals.items():
        tied = [r for r in rivals if r.tied]
        first = {r.term.name: r for r in reversed(tied) if r.term.name != term.name}
        ordered = sorted(tied, key=lambda r: first.get(r.term.name) is not r)
        if tied:
            out[term] = [d.fit, *(r.fit for r in ordered[: CANDIDATES - 1])]
    return out


def ties_of(d: Result) -> list[tuple[tuple[Term, ...], list[Fitted]]]:
    """What the data cannot tell apart: chosen terms with the fits that hold them or others, several where only all of
    them together have something in their place."""
    ties: dict[tuple[Hypothesis, ...], tuple[list[Term], list[Fitted]]] = {}
    for term, fits in candidates_of(d).items():
        ties.setdefault(tuple(f.hypothesis for f in fits), ([], fits))[0].append(term)
    return [(tuple(terms), fits) for terms, fits in ties.values()]


def before_after_noise(report: FitReport | ForceErrors) -> tuple[float, float, float]:
    """Root-mean-square errors of the model as given and of the corrected one, and what noise alone leaves."""
    if isinstance(report, ForceErrors):
        return report.before, report.after, report.floor
    return report.before.rms, report.after.rms, report.floor
